"""Recordings of 50 to 199 samples: refused alone, diagnosed together; each is weighed by the noise of all."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from diagnose.check import Machine, check_log
from diagnose.data.experiment import fewest_of, measured_count, prepare, resting_angle, with_common_noise
from diagnose.data.split import split
from diagnose.fit.fitter import Fitter
from diagnose.options import Options
from diagnose.problem.choose_view import choose_view, with_samples
from diagnose.result import Verdict
from diagnose.thresholds import FEWEST, SHORTEST
from diagnose.verdict.reference import cases_of
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model
from mjsim.recording import load
from simgap.pipeline import diagnose_files

N, DT, FRICTION, INERTIA, NOISE = 100, 0.02, 0.15, 0.12, {"servo": 5e-4, "motor": 0.01}
DRIVES = {"servo": '<position name="s" joint="hinge" kp="20" kv="1.5"/>', "motor": '<motor name="m" joint="hinge"/>'}
LEVELS = {"servo": (0.3, -0.5, 0.8, -0.8, 0.5, -0.3), "motor": (0.8, -1.2, 1.6, -1.6, 1.2, -0.8)}
HEADS = {"servo": "time_s,command_rad,angle_rad", "motor": "time_s,torque_Nm,angle_rad,velocity_rad_s"}


def arm(drive: str, friction: float, inertia: float) -> str:
    """A pendulum; ``inertia`` [kg m^2]: about the joint."""
    centre = inertia - 1.0 * 0.3**2
    return f"""<mujoco><option timestep="5e-4" integrator="RK4"/><worldbody><body name="arm" pos="0 0 1">
        <joint name="hinge" axis="0 1 0" damping=".05" frictionloss="{friction}" solreffriction="-1 -5000"
        solimpfriction=".9999 .9999 .001 .5 2"/><inertial pos="0 0 -.3" mass="1" diaginertia="{centre} {centre} {centre}"/>
        </body></worldbody><actuator>{DRIVES[drive]}</actuator></mujoco>"""


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """Six step responses in plain MuJoCo, 2 s at 50 Hz each; the model lacks friction, and has 1.2 times the inertia."""

    def made(drive: str, seed: int):
        folder = tmp_path_factory.mktemp(f"{drive}{seed}")
        (folder / "model.xml").write_text(arm(drive, 0.0, 1.2 * INERTIA))
        true = mujoco.MjModel.from_xml_string(arm(drive, FRICTION, INERTIA))
        rng, paths = np.random.default_rng(seed), []
        for i, level in enumerate(LEVELS[drive]):
            d, rows = mujoco.MjData(true), []
            for k in range(N):
                u = level if k >= 10 else 0.0
                rows.append((k * DT, u, d.qpos[0], d.qvel[0]))
                d.ctrl[0] = u
                mujoco.mj_step(true, d, round(DT / true.opt.timestep))
            table = np.array(rows) + rng.standard_normal((N, 4)) * [0.0, 0.0, 5e-4, 0.01]
            paths.append(folder / f"log{i}.csv")
            np.savetxt(paths[-1], table[:, : HEADS[drive].count(",") + 1], delimiter=",", header=HEADS[drive], comments="")
        return folder / "model.xml", paths

    return made


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["servo", "motor"])
def test_friction_and_inertia_of_step_responses(steps, drive, tmp_path):
    model, paths = steps(drive, 0)
    options = Options(jobs=1, effects=("coulomb_friction", "time_delay"))
    result = diagnose_files(paths[:4], model, tmp_path, paths[4:], options, progress=False, page=False)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["coulomb_friction"]
    for found, true in ((result.findings[0].parameters["torque_Nm"], FRICTION), (result.linear_parameters["Jm"], INERTIA)):
        assert found.value == pytest.approx(true, rel=0.06 if drive == "servo" else 0.02)
        if drive == "motor":
            assert found.ci95[0] < true < found.ci95[1]
            assert found.ci95[1] - found.ci95[0] < 0.05 * true


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["servo", "motor"])
def test_intervals_of_many_step_responses_hold_the_truth(steps, drive):
    """Of 32 intervals, 95 % of which hold the truth, fewer than 27 do by chance once in three hundred."""
    held = 0
    for seed in range(16):
        model, paths = steps(drive, seed)
        axis, logs = load_axis(model), [load(p, model=model) for p in paths]
        view = choose_view(logs, None, axis)
        fitted, other = split(logs[:4], logs[4:])
        fitter = Fitter(axis, with_samples(view, (*fitted, *other), axis, None), fitted, other, 1)
        guess = fitter.hypothesis((effect_class("coulomb_friction")(place="motor", torque_Nm=0.1),))
        found = fitter.refined(fitter.fit(guess))
        for e, x, error in zip(found.hypothesis.entries, found.fit.x, found.standard_errors(fitter.noise), strict=True):
            true = {"Jm": INERTIA, "torque_Nm": FRICTION if "coulomb" in e.owner else math.nan}.get(e.name, math.nan)
            held += abs(e.si(float(x)) - true) < 1.96 * error
        fitter.close()
    assert held >= 27


def test_recordings_are_counted_together(steps):
    model, paths = steps("motor", 1)
    logs = [load(p, model=model) for p in paths]
    assert fewest_of(logs[:1]) == FEWEST == 2 * measured_count(logs[0])
    assert fewest_of(logs[:2]) == SHORTEST
    assert len(split(logs[:2], logs[2:3])[0]) == 2
    assert len(split(logs[:2], [])[1]) == 2
    with pytest.raises(InputError, match=r"log0.csv: 100 samples .*at least 200, in one recording or in several"):
        split(logs[:1], logs[1:])
    with pytest.raises(InputError, match=r"log0.csv: 49 samples .*expected at least 50; record longer"):
        split([logs[0].slice(0, 49), *logs[1:4]], [])
    machine = Machine.of(load_model(model))
    assert {p.problem for p in check_log(machine, logs[:1]).problems} >= {"short"}
    assert "short" not in {p.problem for p in check_log(machine, logs[:2]).problems}


@pytest.mark.parametrize("drive", ["servo", "motor"])
def test_short_recordings_are_weighed_by_the_noise_of_all(steps, drive):
    """Of a hundred samples the noise of one is off by up to a third."""
    model, paths = steps(drive, 2)
    logs = [load(p, model=model) for p in paths]
    alone = [prepare(r, minimum=SHORTEST).sigma for r in logs]
    fitted, held = split(logs[:4], logs[4:])
    (common,) = {e.sigma for e in (*fitted, *held)}
    assert common == pytest.approx(math.sqrt(np.mean(np.square(alone))), rel=1e-12)
    assert {c.sigma for c in cases_of(logs[:4], logs[4:])} == {common}
    long = dataclasses.replace(prepare(logs[0], minimum=SHORTEST), recording=_long(logs[0]))
    assert with_common_noise([long, *fitted])[0].sigma == long.sigma
    assert with_common_noise([long])[0] is long


def test_a_start_at_rest_is_the_mean_of_the_rows_ahead_of_the_first_step(steps):
    """The first row alone held the model at its noise, by friction, until the step: sixteen per cent more chi-square."""
    model, paths = steps("servo", 3)
    logs = [load(p, model=model) for p in paths]
    for r, case in zip(logs, cases_of(logs[:4], logs[4:]), strict=True):
        angle, error = resting_angle(r)
        assert (prepare(r, minimum=SHORTEST).angle, case.start().angle) == (angle, angle)
        assert angle == pytest.approx(np.mean(r.angle[:10]), abs=1e-12)
        assert abs(angle) < 4 * error < 4 * case.sigma / 2
    at_once = dataclasses.replace(logs[0], command=np.where(np.arange(N) > 0, 0.3, 0.0))
    assert resting_angle(at_once)[0] == at_once.angle[0]
    settling = dataclasses.replace(logs[0], angle=logs[0].angle + 0.02 * np.exp(-0.4 * np.arange(N)))
    assert resting_angle(settling)[0] == settling.angle[0]


def _long(recording):
    """The same samples three times over."""
    repeated = {name: np.tile(getattr(recording, name), 3) for name in ("torque", "angle")}
    return dataclasses.replace(
        recording, time=recording.dt * np.arange(3 * N), velocity=None, control=None, **repeated,
        command=None if recording.command is None else np.tile(recording.command, 3),
    )  # fmt: skip
