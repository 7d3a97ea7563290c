"""Velocity feedforward of a position servo, on one joint: the law beside plain MuJoCo, and its name."""

from __future__ import annotations

import dataclasses
from functools import cache

import mujoco
import numpy as np
import pytest

from diagnose.data.servo import as_servo
from diagnose.data.split import split
from diagnose.fit.fitter import Fitter
from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.problem.choose_view import choose_view, with_samples
from mjsim.effects import effect_class
from mjsim.hold import between
from mjsim.mjcf import load_axis
from mjsim.ode import simulate
from mjsim.recording import Recording
from tests.mjsim.servo_logs import GEARED, PENDULUM, command, model, write

DT, FINER = 0.01, 20
GAIN = {PENDULUM: 0.4, GEARED: 0.0012}
RIVALS = ("actuator_lag", "time_delay", "coulomb_friction", "servo_deadband", "velocity_limit")


@cache
def log(template: str, hold: str, seed: int, seconds: float = 6.0, noise: float = 0.0) -> Recording:
    """A log of plain MuJoCo whose command is moved by the force of the feedforward over kp."""
    m = mujoco.MjModel.from_xml_string(model(template, timestep=DT / FINER))
    d, gear, kp = mujoco.MjData(m), float(m.actuator_gear[0, 0]), float(m.actuator_gainprm[0, 0])
    u = gear * command(seconds, DT, seed)
    first, slope = between(u, DT, hold)
    speed = np.diff(u, prepend=u[:1]) / DT if hold == "held" else slope
    d.qpos[0] = u[0] / gear
    angle = np.empty(len(u))
    for k in range(len(u)):
        angle[k] = d.qpos[0]
        for i in range(FINER):
            d.ctrl[0] = first[k] + slope[k] * (i + 0.5) * DT / FINER + GAIN[template] / kp * speed[k]
            mujoco.mj_step(m, d)
    angle += noise * np.random.default_rng(seed).standard_normal(len(u))
    t, none = DT * np.arange(len(u)), np.full(len(u), np.nan)
    return Recording(t, none, None, angle, DT, command=u, hold=hold, hold_stated=True, source=f"{seed}.csv")


def feedforward(gain: float):
    return effect_class("velocity_feedforward")(place="actuator", gain_Nms_rad=gain)


@pytest.mark.parametrize("hold", ["held", "linear"])
@pytest.mark.parametrize("template", [PENDULUM, GEARED], ids=["pendulum", "geared"])
def test_the_law_is_that_of_plain_mujoco(tmp_path, template, hold):
    axis, r = load_axis(write(tmp_path / "servo.xml", template)), log(template, hold, 1)
    start = np.array([[r.angle[0]], [0.0]])
    both = (axis, axis + feedforward(GAIN[template]))
    errors = [np.std(simulate(a, r.input, DT, initial=start, hold=hold).angle - r.angle) for a in both]
    assert errors[1] < 0.01 * errors[0]


def test_a_lead_of_less_than_a_sample_is_not_admissible(tmp_path):
    axis = load_axis(write(tmp_path / "servo.xml", PENDULUM))
    nominal, fitted, held, _ = as_servo(axis, [log(PENDULUM, "held", 1)], [log(PENDULUM, "held", 2)])
    view, experiments = choose_view(fitted, None, nominal), split(fitted, held)
    fitter = Fitter(nominal, with_samples(view, (*experiments[0], *experiments[1]), nominal, None), *experiments, jobs=1)
    kp = axis.chain.servo.kp
    scales = fitter.scales_for(effect_class("velocity_feedforward"), "actuator")
    fitter.close()
    for lead, admissible in ((0.2 * DT, False), (10.0 * DT, True)):
        assert all(r.holds for r in feedforward(lead * kp).admissible(scales)) == admissible
    fitted = dataclasses.replace(scales, servo=4.0 * kp)  # the fitted stiffness counts, and not that by the recording
    assert not all(r.holds for r in feedforward(2.0 * DT * kp).admissible(fitted))


@pytest.mark.parametrize("rivals", [RIVALS[:2], pytest.param(RIVALS, marks=pytest.mark.slow)], ids=["few", "all"])
def test_it_is_named(tmp_path, rivals):
    axis = load_axis(write(tmp_path / "servo.xml", PENDULUM))
    a, b = (log(PENDULUM, "held", seed, noise=2e-4) for seed in (1, 2))
    found = diagnose(axis, [a], [b], dataclasses.replace(Options(jobs=1), effects=("velocity_feedforward", *rivals)))
    assert [f.effect for f in found.findings] == ["velocity_feedforward"]
    value = found.findings[0].parameters["gain_Nms_rad"]
    assert value.value == pytest.approx(GAIN[PENDULUM], rel=0.05)
    assert value.ci95[0] <= GAIN[PENDULUM] <= value.ci95[1]
