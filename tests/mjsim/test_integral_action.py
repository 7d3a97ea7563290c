"""Integral action of a servo: the law beside plain MuJoCo's ``<pid ki>``, from any start; read from and written to MJCF."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from mjsim.axis import Axis
from mjsim.effects.integral_action import IntegralAction
from mjsim.effects.integral_action_of_cascade import IntegralActionOfCascade
from mjsim.effects.presliding_friction import PreslidingFriction
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mjcf.write import check_writable
from mjsim.mujoco_run import run_literal
from mjsim.ode import simulate
from mjsim.plant import MujocoPlant, Start
from mjsim.servo import Servo, Target
from mjsim.system import assemble

DT = 0.01
TIME = DT * np.arange(250)
STEPS = np.where(TIME % 2.0 < 1.0, 1.0, -0.5)
FILE = """<mujoco><compiler angle="radian"/><option timestep="{timestep}" integrator="implicitfast"/>
  <worldbody>
    <body name="b"><joint name="j" {joint}/><inertial pos="0 0 -.2" mass=".5" diaginertia=".02 .02 .02"/></body>
  </worldbody>
  <actuator>{drive}</actuator>
</mujoco>"""
HINGE, SLIDE = 'axis="0 1 0" damping=".05"', 'type="slide" axis="1 0 0" damping="2"'
POSITION = '<position name="a" joint="j" gear="3" kp="2" kv=".1"{more}/>'
PID = '<pid name="a" joint="j" gear="3" kp="2" kv=".1" ki="7" input="pos"{more}/>'


def write(path: Path, drive: str, *, joint: str = HINGE, more: str = "", timestep: float = 1e-4) -> Path:
    path.write_text(FILE.format(drive=drive.format(more=more), joint=joint, timestep=timestep), encoding="utf-8")
    return path


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.mark.parametrize("joint", [HINGE, SLIDE])
@pytest.mark.parametrize("more", ["", ' ctrlrange="-.4 .8"', ' delay=".023" nsample="300"', ' slewmax="4"'])
def test_the_law_is_that_of_mujoco_from_a_start_in_motion(tmp_path, joint, more):
    """From an angle, a speed and a wound-up integral, under gravity, with what acts on the command on either side."""
    axis = load_axis(write(tmp_path / "pid.xml", PID, joint=joint, more=more))
    states = (("integral_action@actuator.start_Nm", -0.5),)
    run = simulate(axis.started(states), STEPS, DT, initial=np.array([[0.1], [0.5]]), before=STEPS[0])
    seen = MujocoPlant.load(tmp_path / "pid.xml").run(STEPS[:, None], DT, start=Start(0.1, 0.5, STEPS[0], states=states))
    assert rms(seen[:, 1] - run.angle) < 1e-3 * np.std(run.angle)
    unwound = simulate(axis, STEPS, DT, initial=np.array([[0.1], [0.5]]), before=STEPS[0])
    assert rms(unwound.angle - run.angle) > 0.05 * np.std(run.angle), "the start of the integral shows"


def test_at_rest_under_gravity_the_integral_holds_the_weight(tmp_path):
    """With the start that equilibrium asks for, nothing moves; the error is zero, and kp has no part in it."""
    axis = load_axis(write(tmp_path / "pid.xml", PID))
    angle = 0.7
    weight = 0.5 * 9.81 * 0.2 * np.sin(angle)
    held = axis.with_values({"integral_action@actuator.start_Nm": weight / 3.0})
    still = np.full(300, 3.0 * angle)
    for run in (
        simulate(held, still, DT, initial=np.array([[angle], [0.0]])).angle,
        run_literal(
            dataclasses.replace(load_model(tmp_path / "pid.xml"), axis=held), still, DT, initial=np.array([[angle], [0.0]])
        ).angle,
    ):
        assert np.ptp(run) < 1e-9


def test_a_cascade_is_the_law_with_less_of_its_gain_on_the_command(tmp_path):
    """A position loop K ahead of a PI velocity loop (D, I), written out: kp = D K + I, kv = D, ki = I K, weight I."""
    K, D, i, J, f = 6.0, 0.4, 1.5, 0.03, 0.05
    chain = load_axis(write(tmp_path / "p.xml", POSITION)).chain
    body = dataclasses.replace(chain.bodies[0], inertia=J, viscous=f)
    chain = dataclasses.replace(chain, bodies=(body,), gain=1.0, servo=Servo(D * K + i, D))
    law = IntegralActionOfCascade(gain_Nm_rad_s=i * K, weight_Nm_rad=i)
    run = simulate(Axis(chain, (law,)), STEPS, DT)
    q = v = s = 0.0
    out, h = [], DT / 2000
    for c in STEPS:
        out.append(q)
        for _ in range(2000):
            e = K * (c - q) - v
            v += h * (D * e + i * s - f * v) / J
            s += h * e
            q += h * v
    assert rms(run.angle - out) < 1e-3 * np.std(out)
    plain = simulate(Axis(chain, (IntegralAction(gain_Nm_rad_s=i * K),)), STEPS, DT)
    assert rms(plain.angle - out) > 0.05 * np.std(out)


def test_its_state_is_no_bristle(tmp_path):
    """The integration takes the steps that it takes without; beside bristles these alone are what is stiff."""
    axis = load_axis(write(tmp_path / "p.xml", POSITION))
    bristles = PreslidingFriction(torque_Nm=0.1, stiffness_Nm_rad=500.0)
    integral = IntegralAction(gain_Nm_rad_s=7.0)
    assert assemble(axis + integral).steps(DT, 0.0) == assemble(axis).steps(DT, 0.0)
    assert assemble(axis + bristles + integral).steps(DT, 0.0) == assemble(axis + bristles).steps(DT, 0.0)
    both = axis + bristles + integral
    run = simulate(both, STEPS, DT)
    assert rms(run.angle - simulate(both, STEPS, DT, substeps=64).angle) < 1e-3 * np.std(run.angle)


@pytest.mark.parametrize("more", ["", ' forcerange="-5 5" ctrlrange="-4 4"', ' dampratio="1"'])
def test_what_is_found_is_a_pid_that_plain_mujoco_steps(tmp_path, more):
    drive = POSITION if "dampratio" not in more else POSITION.replace(' kv=".1"', "")
    given = load_axis(write(tmp_path / "given.xml", drive, more=more))
    axis = given.with_linear({"kp": 2.2}) + IntegralAction(gain_Nm_rad_s=7.0, start_Nm=0.3)
    assert write_corrected(tmp_path / "given.xml", axis, tmp_path / "out.xml").lacks == ()
    back = load_axis(tmp_path / "out.xml")
    assert back.effects == axis.effects
    assert back.chain.servo == axis.chain.servo
    run = simulate(axis, STEPS, DT, initial=np.array([[0.1], [0.5]]))
    seen = MujocoPlant.load(tmp_path / "out.xml").run(STEPS[:, None], DT, start=Start(0.1, 0.5, STEPS[0]))
    assert rms(seen[:, 1] - run.angle) < 1e-3 * np.std(run.angle)
    write_corrected(tmp_path / "out.xml", given, tmp_path / "again.xml")
    assert load_axis(tmp_path / "again.xml").effects == given.effects, "the correction is taken back"


def test_the_zero_of_the_command_is_carried_beside_it(tmp_path):
    """<pid> integrates the command itself; simgap keeps the zero, and MuJoCo starts as the law with it does."""
    given = load_axis(write(tmp_path / "given.xml", POSITION))
    axis = given.with_linear({"zero": 0.05}) + IntegralAction(gain_Nm_rad_s=7.0)
    write_corrected(tmp_path / "given.xml", axis, tmp_path / "out.xml")
    assert load_axis(tmp_path / "out.xml").chain.servo.zero == 0.05
    short = STEPS[:6]
    run = simulate(axis, short, DT)
    seen = MujocoPlant.load(tmp_path / "out.xml").run(short[:, None], DT, start=Start(0.0, 0.0, short[0]))
    without = simulate(axis.with_linear({"zero": 0.0}), short, DT)
    assert rms(seen[:, 1] - run.angle) < 0.2 * rms(without.angle - run.angle)


def test_an_authored_pid_is_read_and_changed_in_place(tmp_path):
    path = write(tmp_path / "pid.xml", PID)
    axis = load_axis(path)
    (own,) = [e for e in axis.effects if e.id == "integral_action"]
    assert own == IntegralAction(gain_Nm_rad_s=7.0)
    check_writable(path)
    new = axis.with_values({"kp": 2.5, "integral_action@actuator.gain_Nm_rad_s": 9.0})
    write_corrected(path, new, tmp_path / "out.xml")
    back = load_axis(tmp_path / "out.xml")
    assert (back.chain.servo.kp, back.with_effects([]).effects) == (2.5, new.effects)
    model = load_model(tmp_path / "out.xml").mjmodel
    assert model.actuator_gainprm[0, 0] == 9.0


def test_a_limit_of_the_integral_is_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match=r"imax = 0.3; .*use imax=") as error:
        load_axis(write(tmp_path / "pid.xml", PID, more=' imax=".3"'))
    assert "\n" not in str(error.value)


def test_only_a_position_servo_has_it(tmp_path):
    axis = load_axis(write(tmp_path / "p.xml", POSITION))
    velocity = dataclasses.replace(axis.chain, servo=Servo(0.0, 0.1, Target.VELOCITY))
    torque = dataclasses.replace(axis.chain, servo=None)
    for chain in (velocity, torque):
        with pytest.raises(ValueError, match="servo"):
            IntegralAction(gain_Nm_rad_s=1.0).ports(chain)
