"""How the command of a servo goes between samples, where nobody stated it: plain MuJoCo at a tenth of the sample time."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from diagnose.fit.command_hold import hold_instead, is_assumed, shown_hold
from diagnose.result import Verdict
from mjsim.effects import effect_class
from mjsim.hold import within
from mjsim.mjcf import load_axis
from mjsim.recording import Recording
from simgap import servo_log
from tests.mjsim.servo_logs import PENDULUM, command, model, write

DT, FINER, SECONDS = 0.02, 20, 16.0
LEAD = 0.05  # [s] by which a velocity feedforward lets the joint act ahead


def log(hold: str, seed: int, *, friction: float = 0.0, lead: float = 0.0) -> Recording:
    """A log at 50 Hz of a servo whose setpoints go between samples as ``hold`` says; ``lead``: of a velocity feedforward [s]."""
    m = mujoco.MjModel.from_xml_string(model(PENDULUM, friction=friction, kp=10.0, timestep=DT / FINER))
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    u = command(SECONDS, DT, seed)
    fine = within(u, DT, hold, FINER)
    fine = fine + lead * np.gradient(fine, DT / FINER)
    angle = np.empty(len(u))
    d.qpos[0] = u[0]
    for k, target in enumerate(fine):
        if k % FINER == 0:
            angle[k // FINER] = d.qpos[0]
        d.ctrl[0] = target
        mujoco.mj_step(m, d)
    angle += 2e-4 * rng.standard_normal(len(u))
    time = np.arange(len(u)) * DT
    return Recording(time, np.full(len(u), np.nan), None, angle, DT, command=u)


@pytest.fixture(scope="module")
def axis(tmp_path_factory):
    return load_axis(write(tmp_path_factory.mktemp("hold") / "servo.xml", PENDULUM))


@pytest.mark.parametrize(
    ("hold", "friction"),
    [
        ("held", 0.0),
        ("linear", 0.05),
        pytest.param("linear", 0.0, marks=pytest.mark.slow),
        pytest.param("mean", 0.0, marks=pytest.mark.slow),
        pytest.param("held", 0.05, marks=pytest.mark.slow),
    ],
)
def test_the_hold_is_found_with_and_without_dry_friction(axis, hold, friction):
    assert shown_hold(axis, [log(hold, 1, friction=friction)], [log(hold, 2, friction=friction)], math.inf) == hold


@pytest.mark.slow
def test_a_velocity_feedforward_is_no_hold(axis):
    assert shown_hold(axis, [log("linear", 1, lead=LEAD)], [log("linear", 2, lead=LEAD)], math.inf) == "held"


@pytest.mark.parametrize(("hold", "lead", "taken"), [("linear", 0.0, "linear"), ("held", LEAD, "held")])
def test_a_hold_takes_the_place_of_an_effect_that_explains_no_more(axis, hold, lead, taken):
    logs = [log(hold, 1, lead=lead)], [log(hold, 2, lead=lead)]
    ahead = effect_class("velocity_feedforward")(place="actuator", gain_Nms_rad=10.0 * max(lead, DT / 2))
    assert hold_instead(axis.with_effects([ahead]), [axis], *logs, math.inf) == taken


def test_a_stated_hold_stays():
    given = log("linear", 1)
    assert is_assumed([given])
    assert not is_assumed([given, dataclasses.replace(given, hold_stated=True)])
    assert not is_assumed([dataclasses.replace(given, hold="linear")])


@pytest.mark.parametrize(
    ("verdict", "rms", "asked"),
    [(Verdict.UNEXPLAINED, 1.0, True), (Verdict.MISSING_PHYSICS, 1.3, True), (Verdict.MISSING_PHYSICS, 1.0, False)],
)
def test_the_hold_is_asked_for_again_where_effects_leave_more_than_noise(monkeypatch, axis, verdict, rms, asked):
    fit = SimpleNamespace(rms=rms * 2e-4)
    result = SimpleNamespace(verdict=verdict, findings=("velocity_limit",), fit={"corrected": fit}, noise_floor=2e-4)
    monkeypatch.setattr(servo_log, "corrected_axis", lambda nominal, _: nominal)
    monkeypatch.setattr(servo_log, "physics_found", lambda _: [])
    monkeypatch.setattr(servo_log, "is_assumed", lambda _: True)
    monkeypatch.setattr(servo_log, "shown_hold", lambda *_: "linear")
    assert servo_log.hold_beside(result, axis, [], [], 1.0) == ("linear" if asked else "held")
