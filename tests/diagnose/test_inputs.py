"""Logs of an axis that no torque drives: let go and swinging free, a motor by its voltage, a velocity loop without an angle."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import simgap
from diagnose.data.servo import as_servo
from diagnose.pipeline import Options, diagnose
from diagnose.report.words import where
from diagnose.result import Verdict
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mujoco_run import run_signals
from mjsim.ode import simulate
from mjsim.plant import MujocoPlant, Start
from mjsim.recording import Recording
from simgap.pipeline import diagnose_recordings
from simgap.robot import is_robot

DT, STEP = 0.01, 2 * np.pi / 4096
FREE = """<mujoco><option timestep="0.001" integrator="RK4"{gravity}/><worldbody><body name="arm" pos="0 0 1">
<joint name="pivot" axis="0 1 0" damping=".005"/><inertial pos="0 0 -.2" mass=".5" diaginertia=".001 .001 .001"/></body>
</worldbody>{actuator}</mujoco>"""
DC_MOTOR = """<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 0"/><worldbody><body name="rotor">
<joint name="load" axis="0 0 1" damping=".0004"/><inertial pos="0 0 0" mass=".1" diaginertia=".0021 .0021 .0021"/></body>
</worldbody><actuator>{drive}</actuator></mujoco>"""
GENERAL = '<general name="motor" joint="load" gainprm="0.07" biastype="affine" biasprm="0 0 -0.015"/>'
LOOP = '<velocity name="loop" joint="load" kv="0.05"/>'
FEW = Options(effects=("coulomb_friction",))


def write(path: Path, text: str, **parts: str) -> Path:
    path.write_text(text.format(**{"gravity": "", "actuator": "", **parts}) if "{" in text else text, encoding="utf-8")
    return path


def swing(path: Path, start: float, friction: float = 0.0, seconds: float = 6.0) -> Recording:
    """A free swing of the file with Coulomb friction, its angle rounded to the steps of an encoder."""
    axis = load_axis(path)
    if friction:
        axis = axis + effect_class("coulomb_friction")(place="motor", torque_Nm=friction)
    n = round(seconds / DT)
    y = simulate(axis, np.zeros(n), DT, initial=np.array([[start], [0.0]]))
    angle = STEP * np.round(np.array(y.angle) / STEP)
    return simgap.load({"time_s": DT * np.arange(n), "angle_rad": angle}, model=path, name=f"swing {start}")


def commanded(seed: int, n: int) -> np.ndarray:
    rng, t = np.random.default_rng(seed), DT * np.arange(n)
    return np.asarray(sum(a * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f, a in ((0.3, 4.0), (0.9, 3.0), (2.3, 1.5))))


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    return write(tmp_path_factory.mktemp("free") / "model.xml", FREE)


def test_a_model_without_an_actuator_is_an_axis(free):
    chain = load_axis(free).chain
    assert not chain.driven
    assert chain.bodies[0].joint == "pivot"
    with pytest.raises(ValueError, match="no actuator drives"):
        effect_class("actuator_lag")(place="actuator", time_constant_s=0.1).ports(chain)


def test_a_corrected_file_with_a_joint_more_is_read_without_an_actuator(free, tmp_path):
    """The joint of a flexible mode, which the file names as added, does not stand for the drive."""
    mode = effect_class("extra_flexible_mode")(place="arm", inertia_kgm2=0.002, stiffness_Nm_rad=4.0, damping_Nms_rad=0.01)
    write_corrected(free, load_axis(free) + mode, tmp_path / "corrected.xml")
    back = load_axis(tmp_path / "corrected.xml")
    assert [b.joint for b in back.chain.bodies] == ["pivot"]
    assert back.effects[-1] == mode


@pytest.mark.parametrize("more", ["", "jitter = 0.1\n"])
def test_a_model_without_an_actuator_may_state_that_the_drive_was_off(free, tmp_path, more):
    swing(free, 1.2).save(tmp_path / "log.csv")
    (tmp_path / "log.toml").write_text(f'[recording]\ninput = "none"\n{more}time = "time_s"\nangle = "angle_rad"\n')
    assert not is_robot([tmp_path / "log.csv"], free)
    (tmp_path / "log.toml").write_text('[recording]\ninput = "none"\n[joints.a]\nangle = "angle_rad"\n')
    with pytest.raises(InputError, match="input: it is used of one joint only"):
        is_robot([tmp_path / "log.csv"], free)


def test_mujoco_and_the_equations_swing_alike(free):
    n, start = 500, np.array([[1.2], [0.4]])
    engine = simulate(load_axis(free), np.zeros(n), DT, initial=start)
    plant = MujocoPlant.load(free)
    literal = run_signals(load_model(free), np.zeros(n), DT, initial=start)
    y = plant.run(np.zeros((n, 1)), DT, start=Start(1.2, 0.4))
    assert np.max(np.abs(y[:, 1] - engine.angle)) < 1e-5
    assert np.max(np.abs(literal.angle - engine.angle)) < 1e-5
    assert plant.tolerance > 0
    with pytest.raises(ValueError, match="no actuator"):
        plant.inverse(y, DT)


def test_the_check_of_a_free_swing_asks_for_no_torque(free):
    check = simgap.check(swing(free, 1.2), free)
    assert check.verdict.value == "ready", check.problems
    assert "the drive is off" in check.understood["input"]


@pytest.mark.slow
def test_friction_of_a_free_swing_is_found_with_the_drive_off(free, tmp_path):
    logs, other = [swing(free, 1.6, 0.012, 3.0)], swing(free, 2.2, 0.012, 3.0)
    result = diagnose_recordings(logs, free, tmp_path, [other], FEW, progress=False, page=False)
    assert result.verdict is Verdict.MISSING_PHYSICS
    (found,) = result.findings
    assert found.effect == "coulomb_friction"
    assert abs(found.parameters["torque_Nm"].value - 0.012) < 2e-4
    assert any("The weight is taken as the model has it" in note for note in result.notes)
    assert all("torque" not in trace.states for trace in result.traces)
    assert not any("the input" in sentence for sentence in where(result))  # there is none
    corrected = load_axis(tmp_path / "corrected.xml")
    assert not corrected.chain.driven
    run = simgap.simulate(tmp_path / "corrected.xml", other)
    assert np.sqrt(np.mean((run.angle - other.angle) ** 2)) < 4 * STEP


def test_without_a_weight_the_inertia_sets_the_scale(tmp_path):
    path = write(tmp_path / "model.xml", FREE, gravity=' gravity="0 0 0"')
    record = dataclasses.replace(swing(path, 0.0), angle=np.arange(600) * 1e-3)
    axis, _, _, said = as_servo(load_axis(path), [record], [])
    assert axis.chain.held == ("Jm",)
    assert "ratios to the inertia only" in said[-1]


def test_recordings_with_the_drive_on_and_off_are_two_kinds(tmp_path):
    path = write(tmp_path / "model.xml", FREE, actuator='<actuator><motor name="m" joint="pivot"/></actuator>')
    t = DT * np.arange(400)
    on = simgap.load({"time_s": t, "torque_Nm": np.sin(t), "angle_rad": np.sin(t)}, model=path)
    off = simgap.load({"time_s": t, "angle_rad": np.sin(t)}, model=path, binding={"input": "none"})
    with pytest.raises(InputError, match="drive was on"):
        as_servo(load_axis(path), [off], [on])
    axis, _, _, _ = as_servo(load_axis(path), [off], [])
    assert not axis.chain.driven


def test_a_motor_is_diagnosed_by_its_voltage(tmp_path):
    path = write(tmp_path / "model.xml", DC_MOTOR.format(drive=GENERAL))
    axis = load_axis(path) + effect_class("coulomb_friction")(place="motor", torque_Nm=0.03)
    logs = []
    for seed in (1, 2):
        u = commanded(seed, 1000)
        y = simulate(axis, u, DT, initial=np.zeros((2, 1)), before=float(u[0]))
        angle = STEP * np.round(np.array(y.angle) / STEP)
        logs.append(simgap.load({"time_s": DT * np.arange(1000), "voltage_V": u, "angle_rad": angle}, model=path))
    assert simgap.check(logs[0], path).verdict.value == "ready"
    result = diagnose(load_axis(path), logs[:1], logs[1:], FEW)
    assert [f.effect for f in result.findings] == ["coulomb_friction"]
    assert abs(result.findings[0].parameters["torque_Nm"].value - 0.03) < 1e-3


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    """(model, logs) of a velocity loop with Coulomb friction, its velocity recorded and no angle."""
    path = write(tmp_path_factory.mktemp("loop") / "model.xml", DC_MOTOR.format(drive=LOOP))
    axis, rng, logs = (
        load_axis(path) + effect_class("coulomb_friction")(place="motor", torque_Nm=0.03),
        np.random.default_rng(0),
        [],
    )
    for seed in (1, 2):
        u = commanded(seed, 1000)
        y = simulate(axis, u, DT, initial=np.zeros((2, 1)), before=float(u[0]))
        velocity = np.array(y.velocity) + 0.01 * rng.standard_normal(1000)
        logs.append(simgap.load({"time_s": DT * np.arange(1000), "command_rad_s": u, "velocity_rad_s": velocity}, model=path))
    return path, logs


def test_a_velocity_loop_without_an_angle_is_judged_by_its_velocity(loop, tmp_path):
    path, logs = loop
    result = diagnose_recordings(logs[:1], path, tmp_path, logs[1:], FEW, progress=False, page=False)
    assert result.channel == "velocity"
    assert [f.effect for f in result.findings] == ["coulomb_friction"]
    assert abs(result.findings[0].parameters["torque_Nm"].value - 0.03) < 1e-3
    assert any("No angle is recorded" in note for note in result.notes)
    assert result.fit["corrected"].held_out_rms < 1.2 * 0.01


def test_a_position_servo_needs_its_angle(tmp_path):
    path = write(tmp_path / "model.xml", DC_MOTOR.format(drive='<position name="s" joint="load" kp="1"/>'))
    t = DT * np.arange(400)
    record = simgap.load({"time_s": t, "command_rad": np.sin(t), "velocity_rad_s": np.cos(t)}, model=path)
    with pytest.raises(InputError, match="a command and no angle"):
        as_servo(load_axis(path), [record], [])
