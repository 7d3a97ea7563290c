"""A motor with a back-EMF, logged by its voltage: gain and back-EMF are two numbers, and both are fitted."""

from __future__ import annotations

import numpy as np
import pytest

import simgap
from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from mjsim.mjcf import load_axis
from mjsim.recording import Recording
from mjsim.servo import Servo, Target

DT, NOISE = 0.005, 2e-3
MOTOR = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="hub">
<joint name="base" axis="0 0 1" damping="{damping}"/><inertial pos="0 0 0" mass="0.2" diaginertia="0.003 0.003 0.005"/></body>
</worldbody><actuator>
<general name="drive" joint="base" gainprm="{gain}" biastype="affine" biasprm="0 0 -{kv}"/></actuator></mujoco>"""
FEW = Options(jobs=1, effects=("coulomb_friction", "torque_ripple", "actuator_lag"))


def write(folder, name, *, gain=0.002, kv=0.05, damping=0.0):
    path = folder / f"{name}.xml"
    path.write_text(MOTOR.format(gain=gain, kv=kv, damping=damping), encoding="utf-8")
    return path


def voltage(seconds=4.0):
    t = np.arange(0.0, seconds, DT)
    return 80.0 * np.sin(2 * np.pi * (0.3 * t + 0.2 * t**2)) + 30.0 * np.sin(2 * np.pi * 0.2 * t)


def logged(path, u, seed, *, by="angle"):
    run, rng = simgap.simulate(path, u, dt=DT), np.random.default_rng(seed)
    seen = getattr(run, by) + (NOISE if by == "angle" else 0.05) * rng.standard_normal(len(u))
    channels = {"angle": seen if by == "angle" else None, "velocity": seen if by == "velocity" else None}
    return Recording(DT * np.arange(len(u)), np.full(len(u), np.nan), dt=DT, source=f"{seed}.csv", command=u, **channels)


def diagnosed(tmp_path, by="angle", nominal=None, **true):
    path = write(tmp_path, "true", **{**(nominal or {}), **true})
    logs = [logged(path, voltage(), 0, by=by)], [logged(path, 0.8 * voltage()[::-1].copy(), 1, by=by)]
    return diagnose(load_axis(write(tmp_path, "nominal", **(nominal or {}))), *logs, FEW)


@pytest.mark.parametrize("by", ["angle", "velocity"])
def test_another_torque_per_volt_is_a_parameter_and_no_physics(tmp_path, by):
    result = diagnosed(tmp_path, by, gain=0.0024)
    assert result.verdict is Verdict.PARAMETERS_ONLY
    assert result.linear_parameters["gain"].value == pytest.approx(0.0024, rel=5e-3)
    assert result.linear_parameters["gain"].unit == "N m/ctrl"
    assert result.linear_parameters["kv"].value == pytest.approx(0.05, rel=5e-3)
    assert {"Jm", "fm"}.isdisjoint(result.linear_parameters), "of the inertia only ratios show, of kv + f the sum"
    assert any("tell ratios to the inertia only (gain/J, kv/J, friction/J)" in note for note in result.notes)
    assert result.fit["corrected"].held_out_rms < 1.1 * result.noise_floor


def test_another_back_emf_leaves_the_gain_where_it_is(tmp_path):
    result = diagnosed(tmp_path, kv=0.07)
    assert result.verdict is Verdict.PARAMETERS_ONLY
    assert result.linear_parameters["gain"].value == pytest.approx(0.002, rel=5e-3)
    assert result.linear_parameters["kv"].value == pytest.approx(0.07, rel=5e-3)


def test_a_velocity_servo_tells_its_gain_from_the_viscous_friction_beside_it(tmp_path):
    result = diagnosed(tmp_path, nominal={"gain": 0.05, "kv": 0.05, "damping": 0.01}, damping=0.02)
    assert result.verdict is Verdict.PARAMETERS_ONLY
    assert "gain" not in result.linear_parameters, "its command is a velocity: the gain is kv"
    assert result.linear_parameters["kv"].value == pytest.approx(0.05, rel=0.02)
    assert result.linear_parameters["fm"].value == pytest.approx(0.02, rel=0.02)


def test_the_gain_stays_while_the_back_emf_changes():
    motor = Servo(0.0, 0.05, Target.VELOCITY, scale=0.04)
    assert motor.back_emf
    assert motor.gain == pytest.approx(0.002)
    changed = motor.with_numbers({"kv": 0.1})
    assert (changed.gain, changed.kv) == (pytest.approx(0.002), 0.1)
    assert motor.with_numbers({"gain": 0.003}).scale == pytest.approx(0.06)
    servo = Servo(0.0, 0.05, Target.VELOCITY)
    assert not servo.back_emf
    assert servo.with_numbers({"kv": 0.1}) == Servo(0.0, 0.1, Target.VELOCITY)
