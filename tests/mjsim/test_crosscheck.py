"""Every registered effect in MuJoCo against the analytic equations, within the tolerance that the effect declares."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from robot_axis import DT, axis, chirp, effect

from mjsim import accurate, ode, reference
from mjsim.axis import Axis
from mjsim.batch import Drive, Engine, rollout
from mjsim.chain import Chain
from mjsim.crosscheck import Case, Report, Row, Status, check_all, compare, effect_cases, energy_error, plot, table
from mjsim.crosscheck.engines import truth_of
from mjsim.effects import registered
from mjsim.errors import CheckError
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from simgap.commands import crosscheck as face

ROBOT = load_axis(shipped_model("robot_axis1"))
U = chirp(1.0)
PLACES = {f"{n}@{p}": cls.family for n, cls in registered().items() for p in cls.places}
SERVO = {key for key, family in PLACES.items() if family == "servo"}
OTHERS = PLACES.keys() - SERVO
FIRST = {key.partition("@")[0]: key for key in sorted(OTHERS, reverse=True)}  # of an effect's places
MOTOR = Axis(Chain(ROBOT.chain.bodies[:1], ()))


@pytest.fixture(scope="module")
def cases() -> dict[str, Case]:
    """By effect and place; stops act on the motor alone, since limits need code of their own at each number of bodies."""
    stops = {name for name in registered() if name.endswith("joint_stop")}
    found, skipped = effect_cases(ROBOT, U, names=registered().keys() - stops)
    assert {key for key, _ in skipped} == SERVO, "tests/mjsim/test_servo.py holds those against a reference of their own"
    more, skipped = effect_cases(MOTOR, U, names=stops)
    assert not skipped
    return {c.name: c for c in (*found, *more)}


def test_every_registered_effect_has_a_case_at_every_place(cases: dict[str, Case]) -> None:
    assert {c.axis.effects[0].key for c in cases.values()} == cases.keys() == OTHERS


@pytest.mark.parametrize(
    "name", [key if key in FIRST.values() else pytest.param(key, marks=pytest.mark.slow) for key in sorted(OTHERS)]
)
def test_both_realisations_agree(name: str, cases: dict[str, Case]) -> None:
    case = cases[name]
    exact = reference.not_affine(case.axis) is None
    model = case.axis
    u = case.drive * U
    truth = reference.simulate(model, u, DT) if exact else ode.simulate(model, u, DT, substeps=16)
    assert np.ptp(truth.velocity) > 0
    for run, limit in ((accurate.simulate(model, u, DT), case.accurate), (ode.simulate(model, u, DT), case.kernel)):
        error = np.sqrt(np.mean((run.velocity - truth.velocity) ** 2) / np.mean(truth.velocity**2))
        assert error < limit


def test_the_effects_are_felt(cases: dict[str, Case]) -> None:
    """A comparison of effects that change nothing would prove nothing."""
    runs = {(a.chain, s): simulate(a, s * U, DT).velocity for a in (ROBOT, MOTOR) for s in (1.0, -1.0)}
    assert {c.name for c in cases.values() if c.drive < 0} == {"lower_joint_stop@motor"}
    for case in cases.values():
        changed, bare = simulate(case.axis, case.drive * U, DT).velocity, runs[case.axis.chain, case.drive]
        assert np.sqrt(np.mean((changed - bare) ** 2) / np.mean(bare**2)) > 3e-4, case.name


@pytest.mark.parametrize("engine", [reference.simulate, ode.simulate, accurate.simulate])
def test_energy_balances(engine: object) -> None:
    model = axis(effect("coulomb_friction", torque_Nm=0.1), effect("backlash", gap_rad=5e-4)).with_linear({"dg": 0.0})
    start = np.zeros((2, 3))
    start[0, 2] = 0.01
    run = engine(model, np.zeros(2001), 5e-5, initial=start)  # type: ignore[operator]
    assert energy_error(model, run) < 1e-6


def test_a_miss_is_named_and_ends_with_check_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cases: dict[str, Case]
) -> None:
    from mjsim.crosscheck import run as module

    strict = [dataclasses.replace(next(iter(cases.values())), accurate=1e-12, literal=None)]
    monkeypatch.setattr(module, "study_cases", lambda axis: strict)
    monkeypatch.setattr(module, "effect_cases", lambda axis, u: ([], [("nothing@arm", "no place")]))
    monkeypatch.setattr(module, "scaling_row", lambda *a: Row("scaling law", "itself", 0.0, 0.0, ()))
    monkeypatch.setattr(module, "energy_rows", lambda *a: [])
    result = CliRunner().invoke(face.command, ["--out", str(tmp_path), "--duration", "1"])
    assert isinstance(result.exception, CheckError)
    assert "accurate" in str(result.exception)
    assert "not compared: nothing@arm" in result.output
    assert (tmp_path / "crosscheck.png").stat().st_size > 5000
    assert (tmp_path / "crosscheck.json").is_file()


def test_load_dependent_friction_of_one_rigid_body_agrees_in_every_engine(tmp_path: Path) -> None:
    """On an axis of one body its load is the torque of the drive."""
    path = tmp_path / "own.xml"
    path.write_text(RIGID["pendulum"], encoding="utf-8")
    own, u = load_axis(path), chirp(2.0)
    (case,), skipped = effect_cases(own, u, names={"load_dependent_friction"})
    assert case.name == "load_dependent_friction@motor"
    assert [key for key, _ in skipped] == ["load_dependent_friction@gearbox"]
    assert np.std(simulate(case.axis, u, DT).velocity - simulate(own, u, DT).velocity) > 1e-3 * np.std(
        simulate(own, u, DT).velocity
    )
    ((batched,),) = rollout([case.axis], [Drive(u, DT)], engine=Engine.ACCURATE)
    assert isinstance(batched, ode.Trajectory)
    row = compare(case, path, u, DT, batched)
    assert {c.engine: c.status for c in row.cells} == {
        **dict.fromkeys(("kernel", "accurate", "batch"), Status.HOLDS),
        "literal": Status.ABSENT,
    }


@pytest.mark.slow
def test_the_whole_crosscheck_holds(tmp_path: Path) -> None:
    *rows, report = list(check_all())
    assert isinstance(report, Report)
    assert not report.missed
    assert all(math.isfinite(r.sensitivity) for r in report.rows)
    assert all(c.status is not Status.CHAOTIC for r in report.rows for c in r.cells)
    assert len(table(report.rows)) > len(rows)
    plot(report, tmp_path / "all.png")


OWN = """<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
  <body name="motor"><joint name="motor" axis="0 0 1" damping=".05"/><inertial pos="0 0 0" mass="1" diaginertia=".02 .02 .02"/>
  <body name="load">{slack}<joint name="shaft" axis="0 0 1" stiffness="{stiffness}"/>
  <inertial pos="0 0 0" mass="1" diaginertia=".05 .05 .05"/></body></body></worldbody>
  <tendon><fixed name="across" damping="{damping}">{across}<joint joint="shaft" coef="1"/></fixed></tendon>
  <actuator><motor name="drive" joint="motor"/></actuator></mujoco>"""
SLACK = '<joint name="slack" axis="0 0 1" limited="true" range="-.0025 .0025" armature="5e-4"/>'
ACROSS = '<joint joint="slack" coef="1"/>'
OWN_MODELS = {
    "coarse timestep": OWN.format(step=4e-3, integrator="Euler", slack="", stiffness=20, damping=0.05, across=""),
    "play of its own": OWN.format(step=5e-4, integrator="RK4", slack=SLACK, stiffness=120, damping=0.3, across=ACROSS),
}


@pytest.mark.slow  # some thirty effects by four engines each
@pytest.mark.parametrize("name", OWN_MODELS)
def test_no_form_that_is_written_fails_on_a_users_model(name: str, tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    path.write_text(OWN_MODELS[name], encoding="utf-8")
    report = [item for item in check_all(path, duration=1.0) if isinstance(item, Report)][-1]
    assert report.missed == ()
    written = [cell for row in report.rows for cell in row.cells if cell.engine == "literal" and cell.status is Status.HOLDS]
    assert len(written) >= 8
    assert {cell.limit for cell in written} != {2e-3} or name != "coarse timestep"


PENDULUM = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="{integrator}"/><worldbody><body name="rod">
  <joint name="hinge" {axis} damping=".02"/><geom name="bob" type="sphere" size=".04" pos="{at}" mass="1"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
RIGID = {
    "pendulum": PENDULUM.format(integrator="Euler", axis='axis="0 1 0"', at="0 0 -.5"),
    "pendulum, RK4": PENDULUM.format(integrator="RK4", axis='axis="0 1 0"', at="0 0 -.5"),
    "slide": PENDULUM.format(integrator="implicitfast", axis='type="slide" axis="1 0 0"', at="0 0 0"),
}


def _behind_motor(text: str, tmp_path: Path, seconds: float) -> Row:
    """The comparison of backlash behind the motor of an axis of one body."""
    path = tmp_path / "own.xml"
    path.write_text(text, encoding="utf-8")
    own = load_axis(path)
    u = chirp(seconds)
    (case,), _ = effect_cases(own, u, names={"backlash_behind_motor"})
    ((batched,),) = rollout([case.axis], [Drive(u, DT)], engine=Engine.ACCURATE)
    assert isinstance(batched, ode.Trajectory)
    return compare(case, path, u, DT, batched)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pendulum", "pendulum, RK4", "slide"])
def test_a_gap_behind_the_motor_of_a_users_model_is_stepped_as_found(name: str, tmp_path: Path) -> None:
    row = _behind_motor(RIGID[name], tmp_path, 2.0)
    assert {c.engine: c.status for c in row.cells} == dict.fromkeys(("kernel", "accurate", "batch", "literal"), Status.HOLDS)
    note = row.cells[-1].note
    assert "timestep" not in note or "that is written" in note


@pytest.mark.slow
def test_a_form_of_another_law_misses_at_every_timestep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mjsim.mjcf import native_write
    from mjsim.mjcf.slack_write import loosen_link as right

    monkeypatch.setattr(native_write, "loosen_link", lambda e, n, v: right(e, n, dataclasses.replace(v, width=1.1 * v.width)))
    row = _behind_motor(RIGID["pendulum"], tmp_path, 1.0)
    status = {c.engine: c.status for c in row.cells}
    assert status["literal"] is Status.MISSED
    assert status["kernel"] is Status.HOLDS


def test_a_wrong_kernel_misses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mjsim.crosscheck import engines

    class Wrong:
        @staticmethod
        def simulate(model: object, u: np.ndarray, dt: float, **more: object) -> object:
            return ode.simulate(model, 1.01 * u, dt, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(engines, "ode", Wrong)
    row = _behind_motor(RIGID["pendulum"], tmp_path, 1.0)
    assert row.cells[0].status is Status.MISSED


def test_a_case_is_compared_until_it_becomes_chaotic(tmp_path: Path) -> None:
    """Impacts magnify a change of the input; without them it stays as it is."""
    path = tmp_path / "own.xml"
    path.write_text(RIGID["pendulum"], encoding="utf-8")
    own, u = load_axis(path), chirp(4.0)
    (case,), _ = effect_cases(own, u, names={"backlash_behind_motor"})
    struck, free = truth_of(case.axis, u, DT), truth_of(own, u, DT)
    assert free.judged == len(u)
    assert free.condition < 2.0 < struck.condition
    assert 0.1 * len(u) <= struck.judged < len(u)
    line = next(
        x
        for x in table([Row("case", "exact", 0.0, 3.0, (), 1.0), Row("whole", "exact", 0.0, 1.0, (), 4.0)])
        if "over" in x and "first" in x
    )
    assert line == "case: compared over the first 1 s"
