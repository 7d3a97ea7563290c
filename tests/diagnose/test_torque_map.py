"""What no effect explains is mapped: the map follows held-out data, is written, replays, and is not given where it fails."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis.strategies import floats, integers
from robot_axis import effect

from diagnose.data.experiment import prepare
from diagnose.evidence.predictable import _dictionary
from diagnose.explain.map_regression import Regression, roughness, solve
from diagnose.explain.torque_map import _Responses, fit_map
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from diagnose.report.page import render_report
from diagnose.result import Verdict
from diagnose.thresholds import ROUNDING
from mjsim.effects.base import Effect, Scales, parameter
from mjsim.effects.law import INPUT, RATE, law
from mjsim.effects.ports import BodyTorque
from mjsim.excitation import Cascade, close_loop, trapezoids
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.quantity import Quantity
from mjsim.recording import Recording
from mjsim.torque_map import MapAxis, TorqueMap
from simgap.cli import cli
from simgap.pipeline import diagnose_files

NOISE = 0.05


@law
def fade(z: Any, p: Any, out: Any) -> None:
    """The actuator weakens with speed while it drives: on no registry."""
    out[0] = -p[0] * abs(z[RATE]) * z[INPUT] if z[RATE] * z[INPUT] > 0.0 else 0.0


@dataclass(frozen=True, kw_only=True)
class Fade(Effect):
    id: ClassVar[str] = "fade"
    places: ClassVar[tuple[str, ...]] = ("motor",)

    per_rad_s: float = parameter(Quantity.RATIO, "share of the torque lost per rad/s")

    def ports(self, chain):
        return (BodyTorque(0, fade, (self.per_rad_s,)),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        return []


@pytest.fixture(scope="module")
def faded(pair, robot):
    """(recordings, result): a torque that fades with speed, and only a delay to explain it by."""
    recordings = pair(Fade(per_rad_s=8e-3), seconds=1.0)
    return recordings, diagnose(robot, recordings[:1], recordings[1:], Options(jobs=1, effects=("time_delay",)))


def test_a_map_of_the_right_place_and_variables_is_given(faded):
    _, result = faded
    assert result.verdict is Verdict.UNEXPLAINED
    m = result.map
    assert m is not None
    assert (m.effect.place, m.element) == ("motor", "motor")
    assert [v.name for v in m.variables] == ["velocity", "torque command"]
    assert m.held_out_error_before == result.fit["corrected"].held_out_rms
    assert m.held_out_error_after == result.fit["mapped"].held_out_rms
    assert m.held_out_error_before > 3 * m.held_out_error_after
    assert m.held_out_error_after < 1.3 * NOISE
    assert m.p_value < 1e-3
    assert "not a cause" in m.sentence
    assert "fade" not in json.dumps(result.as_dict(), default=float)


def test_none_is_fitted_where_another_diagnosis_is_better(faded, robot):
    (estimation, held_out), given = faded
    asked = []
    options = Options(jobs=1, effects=("time_delay",))
    result = diagnose(robot, [estimation], [held_out], options, surpassed=lambda bare: not asked.append(bare))
    assert result.map is None
    assert [(bare.verdict, bare.map) for bare in asked] == [(given.verdict, None)]
    assert result.fit["corrected"].rms == given.fit["corrected"].rms
    assert result.simulations < given.simulations


def test_the_bands_hold_the_truth_up_to_what_the_models_own_numbers_can_say(faded):
    """A constant, and parts linear in speed or command, are the model's own: the rest of the surface is the truth's."""
    (estimation, _), result = faded
    m = result.map
    v, u = np.meshgrid(m.variables[0].grid, m.variables[1].grid, indexing="ij")
    truth = np.where(v * u > 0, -8e-3 * np.abs(v) * u, 0.0)
    seen, _, _ = np.histogram2d(estimation.velocity, estimation.torque, bins=[_edges(a.grid) for a in m.variables])
    where = seen > 20
    own = np.column_stack([np.ones(where.sum()), v[where], u[where]])
    off = m.values[where] - truth[where]
    off -= own @ np.linalg.lstsq(own, off, rcond=None)[0]
    half = 0.5 * (m.high - m.low)[where]
    assert np.all(half > 0)
    assert np.sqrt(np.mean(off**2)) < 0.15 * np.std(truth[where])
    assert np.mean(np.abs(off) < 2 * half) > 0.7


def _edges(grid):
    return np.concatenate([[-np.inf], 0.5 * (grid[1:] + grid[:-1]), [np.inf]])


@pytest.mark.slow
def test_the_same_with_two_threads(faded, robot):
    (estimation, held_out), one = faded
    two = diagnose(robot, [estimation], [held_out], Options(jobs=2, effects=("time_delay",)))
    assert two.map.effect == one.map.effect


def test_the_page_shows_it(faded):
    _, result = faded
    page = render_report(result)
    assert "Torque map, at the motor" in page
    assert "a map, not a cause" in page
    assert "with the torque map" in page
    assert "var(--mapped)" in page
    assert "simgap replay mapped.xml" in page


def write(path, r):
    with path.open("w", newline="", encoding="utf-8") as handle:
        rows = csv.writer(handle)
        rows.writerow(["time_s", "torque_Nm", "velocity_rad_s", "angle_rad"])
        rows.writerows(zip(r.time, r.torque, r.velocity, r.angle, strict=True))
    return path


@pytest.mark.slow
def test_it_is_written_and_replays(faded, tmp_path):
    (estimation, held_out), _ = faded
    one, two = write(tmp_path / "log.csv", estimation), write(tmp_path / "other.csv", held_out)
    out = tmp_path / "report"
    options = Options(jobs=1, effects=("time_delay",))
    result = diagnose_files([one], shipped_model("robot_axis1"), out, [two], options, progress=False)
    assert {p.name for p in out.iterdir()} == {"corrected.xml", "diagnosis.json", "mapped.xml", "report.html"}
    said = json.loads((out / "diagnosis.json").read_text())["map"]
    assert (said["place"], said["element"], said["acts"]) == ("motor", "motor", "on the body")
    assert [len(v["grid"]) for v in said["variables"]] == list(np.shape(said["values"])) == list(np.shape(said["ci95"][0]))
    assert said["held_out_error_after"] < said["held_out_error_before"]
    assert load_axis(out / "mapped.xml").effects[-1] == result.map.effect
    for engine in ("ode", "mujoco"):
        arguments = ["replay", str(out / "mapped.xml"), str(two), "--out", str(tmp_path / "p.csv"), "--json", "--engine", engine]
        answer = CliRunner().invoke(cli, arguments)
        assert answer.exit_code == 0, answer.output
        assert json.loads(answer.output)["rms"] == pytest.approx(said["held_out_error_after"], rel=0.02)
    # the next diagnosis of another case leaves no map of this one behind
    write(one, simulated(estimation)), write(two, simulated(held_out, seed=1))
    again = diagnose_files([one], shipped_model("robot_axis1"), out, [two], options, progress=False)
    assert again.map is None
    assert not (out / "mapped.xml").exists()


def simulated(r, seed=0):
    """The first quarter of the experiment on the nominal axis."""
    n = len(r) // 4
    run = simulate(load_axis(shipped_model("robot_axis1")), r.torque[:n], r.dt)
    noise = NOISE * np.random.default_rng(seed).standard_normal(n)
    return Recording(r.time[:n], r.torque[:n], run.velocity + noise, np.array(run.angle), r.dt)


def test_none_is_given_where_nothing_is_left(pair, robot):
    estimation, held_out = pair(seconds=1.0)
    fitter = Fitter(robot, MotionView(), (prepare(estimation),), (prepare(held_out),), 1)
    base = fitter.fit(fitter.hypothesis(()))
    assert fit_map(fitter, (base,), fitter.validate(base)) is None


def test_none_is_given_where_no_torque_is_missing(pair, robot):
    """The sensor repeats itself now and then: no torque anywhere does that."""
    estimation, held_out = pair(seconds=1.0)
    for r in (estimation, held_out):
        held = np.array(r.velocity)
        for start in np.random.default_rng(len(r)).integers(100, len(r) - 100, 40):
            held[start : start + 30] = held[start]
        object.__setattr__(r, "velocity", held)
    fitter = Fitter(robot, MotionView(), (prepare(estimation),), (prepare(held_out),), 1)
    base = fitter.fit(fitter.hypothesis(()))
    found = fit_map(fitter, (base,), fitter.validate(base))
    assert found is None or found.held_out.rms > 0.8 * fitter.validate(base).rms


@pytest.mark.slow
def test_a_model_that_holds_a_map_gets_no_second_one(faded, robot):
    (estimation, held_out), result = faded
    fitter = Fitter(robot + result.map.effect, MotionView(), (prepare(estimation),), (prepare(held_out),), 1)
    base = fitter.fit(fitter.hypothesis(()))
    assert fit_map(fitter, (base,), fitter.validate(base)) is None


def slide(seed, speed):
    """A slide under a position loop with dry friction that no candidate explains."""
    axis = load_axis(shipped_model("emps")) + effect("coulomb_friction", torque_Nm=20.0)
    reference = trapezoids(12.0, 1e-3, speed, 0.4, 0.6, 0.1)
    force = close_loop(axis, reference, 1e-3, Cascade(160.0, 8000.0, 0.0, 1000.0))
    run = simulate(axis, force, 1e-3)
    logged = force + 0.5 * np.random.default_rng(seed).standard_normal(len(force))
    return Recording(run.time, logged, None, 5e-8 * np.round(run.angle / 5e-8), 1e-3, source=f"slide_{seed}.csv", loop="closed")


def test_a_map_that_nothing_answers_to_is_level():
    rng = np.random.default_rng(0)
    r, J, S = rng.standard_normal(300), rng.standard_normal((300, 2)), np.diff(np.eye(8), 2, axis=0)
    solution = solve(Regression(r, np.zeros(8), J, np.zeros((300, 8)), S, np.arange(300) % 4), float(r @ r))
    assert np.all(solution.c == 0)
    assert solution.cost > 0.9


@given(seed=integers(0, 10_000), slope=floats(-3.0, 3.0))
@settings(max_examples=30, deadline=None)
def test_the_regression_is_the_penalised_least_squares_that_it_says(seed, slope):
    """With the ridge of its normal equations, whatever the units, and where the penalty leaves a straight line alone."""
    rng = np.random.default_rng(seed)
    axis = MapAxis("velocity", -1.0, 1.0, 8)
    shape = TorqueMap(place="motor", axes=(axis,), coefficients=(0.0,) * axis.count)
    x = rng.uniform(-1, 1, 400)
    D, J, S = 1e-3 * shape.row(x), 1e3 * np.column_stack([np.ones(400), rng.standard_normal(400)]), roughness(shape)
    r = J @ [0.002, -0.001] - 1e-3 * slope * x + 1e-2 * rng.standard_normal(400)
    p = Regression(r, np.zeros(D.shape[1]), J, D, S, np.arange(400) % 5)
    s = solve(p, float(r @ r))
    root = np.sqrt(s.penalty)
    ridge = ROUNDING**0.25 * np.diag(np.concatenate([np.linalg.norm(J, axis=0), np.ones(s.V.shape[1])]))
    A = np.block([[J, D @ s.V], [np.zeros((len(S), 2)), root * S @ s.V], [ridge]])
    size = np.linalg.norm(A, axis=0)
    b = -np.linalg.lstsq(A / size, np.concatenate([r, np.zeros(len(A) - len(r))]), rcond=1e-14)[0] / size
    np.testing.assert_allclose(D @ s.c, D @ (s.V @ b[2:]), atol=1e-7 * float(np.std(r)))


@pytest.mark.parametrize("seed", range(30))
def test_what_one_stretch_alone_shows_is_no_reason_to_refuse_a_map(seed):
    """A straight line that the model's own numbers do as well but in one fold: the others do not say how much of it there is."""
    rng = np.random.default_rng(seed)
    axis = MapAxis("velocity", -1.0, 1.0, 12)
    shape = TorqueMap(place="motor", axes=(axis,), coefficients=(0.0,) * axis.count)
    x, fold = rng.uniform(-1, 1, 400), np.arange(400) % 5
    D = 1e-3 * shape.row(x)
    line = D @ np.linspace(-1, 1, axis.count) * (1 + 1e-5 * rng.standard_normal(400))
    J = np.column_stack([np.ones(400), line + 1e-3 * (fold == 0) * rng.standard_normal(400)])
    r = 0.1 * np.sin(5 * x) + 0.01 * rng.standard_normal(400)
    assert solve(Regression(r, np.zeros(axis.count), J, D, roughness(shape), fold), float(r @ r)).cost < 0.1


@pytest.mark.slow
def test_a_map_over_the_speed_judged_by_force():
    axis = load_axis(shipped_model("emps"))
    result = diagnose(axis, [slide(0, 0.1)], [slide(1, 0.07)], Options(jobs=1, effects=("time_delay",)))
    assert result.view.startswith("force")
    assert result.verdict is Verdict.UNEXPLAINED
    m = result.map
    assert m is not None
    assert "velocity" in [v.name for v in m.variables]
    assert m.unit == "N"
    assert m.held_out_error_after < 0.5 * m.held_out_error_before


def test_nothing_is_told_by_an_axis_that_swings_up(robot, pair, monkeypatch):
    """Friction may hold what the linear numbers beside it let go: responses through those alone leave all numbers."""
    fitter = Fitter(robot, MotionView(), *((prepare(r),) for r in pair()), 1)
    best = fitter.fit(fitter.hypothesis(()))
    experiment, loose = fitter.experiments[0], robot.with_linear({"fm": -0.5})
    response = _Responses(fitter, best)._through(loose, 0, experiment, 0, np.ones((len(experiment.recording), 1)))
    assert np.isnan(response[-1]).all()
    monkeypatch.setattr("diagnose.evidence.predictable._clean_velocity", lambda *_: experiment.recording.velocity)
    assert np.isfinite(_dictionary(fitter, loose, experiment, None)).all()
    monkeypatch.setattr(_Responses, "_through", lambda *_: np.full_like(_[-1], np.nan))
    assert fit_map(fitter, (best,), fitter.validate(best)) is None
