"""Torque logs cut from faster ones: the torque is not held between samples, and nobody states how it goes."""

from __future__ import annotations

import dataclasses
from functools import cache
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from diagnose.fit.command_hold import earlier, hold_shows, is_assumed
from diagnose.pipeline import Options
from diagnose.result import Verdict
from mjsim.mjcf import load_axis
from mjsim.recording import load
from simgap import torque_log
from simgap.pipeline import diagnose_files
from simgap.torque_log import checked_torque

STEP, SIGMA = 5e-4, 0.02
PENDULUM = """<mujoco><option timestep="0.0005"/><worldbody><body name="rod" pos="0 0 1">
  <joint name="hinge" axis="0 1 0" damping="0.05" frictionloss="{friction}"/>
  <inertial pos="0 0 -.3" mass=".5" diaginertia=".02 .02 .02"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""


@cache
def table(friction: float, seed: int, every: int, *, held: bool, seconds: float = 8.0) -> np.ndarray:
    """Rows of a log of a slow torque, every so-manyth step of MuJoCo; ``held``: the torque changes at the rows alone."""
    m = mujoco.MjModel.from_xml_string(PENDULUM.format(friction=friction))
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    t = STEP * np.arange(round(seconds / STEP))
    tones = [np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.23, 0.6, 1.1, 1.9, 3.1)]
    torque = 0.5 * np.minimum(t, 1.0) * np.sum(tones, axis=0)
    rows = np.empty((len(t), 4))
    for k, u in enumerate(torque):
        if not held or k % every == 0:
            d.ctrl[0] = u
        rows[k] = t[k], d.ctrl[0], d.qpos[0], d.qvel[0]
        mujoco.mj_step(m, d)
    rows[:, 2:] += rng.standard_normal((len(t), 2)) * [2e-4, SIGMA]
    return rows[::every]


def files(folder, friction, in_model, every, *, held):
    model = folder / "pendulum.xml"
    model.write_text(PENDULUM.format(friction=in_model))
    logs = [folder / f"{name}.csv" for name in ("estimation", "held_out")]
    for seed, path in enumerate(logs):
        rows = table(friction, seed, every, held=held)
        np.savetxt(path, rows, delimiter=",", header="time_s,torque_Nm,angle_rad,velocity_rad_s", comments="", fmt="%.9g")
    return model, logs


def taken(model, logs):
    """The hold that the check takes, and what it says of it."""
    first, second = (load(path, model=model) for path in logs)
    log, fitted, _ = checked_torque(model, load_axis(model), [first], [second], Options(), accept=False)
    return fitted[0].hold, [p for p in log.problems if p.problem == "hold"]


@pytest.mark.parametrize(("every", "held"), [(20, False), (20, True), (10, False)])
def test_a_torque_that_was_cut_from_a_faster_log_goes_in_straight_lines(tmp_path, every, held):
    hold, problems = taken(*files(tmp_path, 0.35, 0.0, every, held=held))
    assert hold == ("held" if held else "linear")
    assert [(p.channel, p.value) for p in problems] == ([] if held else [("torque", -0.5)])
    assert held or problems[0].sentence.startswith(
        "The torque goes in straight lines between samples, and is not held as assumed"
    )


def test_refits_are_made_only_where_the_hold_shows(tmp_path, monkeypatch):
    """Not where it is stated, where force is compared, or where half a sample moves less than noise hides."""
    model, logs = files(tmp_path, 0.35, 0.35, 20, held=True)
    first, second = (load(path, model=model) for path in logs)
    axis, asked = load_axis(model), []
    monkeypatch.setattr(torque_log, "shown_hold", lambda *_: asked.append(1) or "held")

    def ask(options=Options(), **what):  # noqa: B008
        asked.clear()
        checked_torque(
            model, axis, [dataclasses.replace(first, **what)], [dataclasses.replace(second, **what)], options, accept=False
        )
        return bool(asked)

    assert ask()
    assert not ask(hold_stated=True)
    assert not ask(Options(judge="force"))
    assert not ask(velocity=None)
    assert hold_shows(axis, [first], [second])
    noisy = [dataclasses.replace(r, noise={**r.noise, "velocity": 0.5, "angle": 0.5}) for r in (first, second)]
    assert not hold_shows(axis, noisy[:1], noisy[1:])


def test_an_input_is_moved_ahead_by_two_samples():
    torque = SimpleNamespace(command=None, driven=True, hold="held", hold_stated=False)
    assert not is_assumed([torque])  # neither a recording of a joint nor a command
    rows = table(0.35, 0, 20, held=True)
    r = dataclasses.replace(_recording(rows), torque=np.arange(5.0))
    assert is_assumed([r])
    np.testing.assert_array_equal(earlier(r).torque, [2, 3, 4, 4, 4])


def _recording(rows):
    from mjsim.recording import Recording

    t, u, q, v = rows[:5].T
    return Recording(t, u, v, q, t[1] - t[0], source="log.csv")


@pytest.mark.parametrize("every", [20, pytest.param(10, marks=pytest.mark.slow), pytest.param(4, marks=pytest.mark.slow)])
def test_the_file_itself_is_no_mismatch_at_a_slower_rate(tmp_path, every):
    """At 500 Hz the hold shows only beside MuJoCo's soft friction, after the search."""
    model, logs = files(tmp_path, 0.35, 0.35, every, held=False)
    result = diagnose_files(logs[:1], model, tmp_path / "out", logs[1:], Options(jobs=1), progress=False, page=False)
    assert result.verdict in (Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY)
    assert result.fit["corrected"].held_out_rms < 1.1 * SIGMA


@pytest.mark.slow
@pytest.mark.parametrize("every", [4, 20])
def test_dry_friction_is_found_at_a_slower_rate(tmp_path, every):
    model, logs = files(tmp_path, 0.35, 0.0, every, held=False)
    result = diagnose_files(logs[:1], model, tmp_path / "out", logs[1:], Options(jobs=1), progress=False, page=False)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["coulomb_friction"]
    assert result.findings[0].parameters["torque_Nm"].value == pytest.approx(0.35, rel=0.02)
