"""Logs of servos and voltage drives whose channels look odd and are sound, and what is to be said of those that are not."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

import simgap
from diagnose.robot.check.channels import refreshed
from diagnose.robot.check.relations import relate
from mjsim.binding import Channel
from mjsim.errors import InputError
from mjsim.readers.headers import guess
from simgap.commands.replay import command as replay_command

DT, N = 0.005, 1200
WEAK = """<mujoco><option timestep="0.001"/><worldbody><body><joint name="servo" axis="0 1 0" armature="0.002" damping="0.02"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>
<actuator><position name="weak" joint="servo" kp="0.2" kv="0.04"/></actuator></mujoco>"""
MOTOR = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body><joint name="base" axis="0 0 1"/>
<inertial pos="0 0 0" mass="0.2" diaginertia="0.003 0.003 0.005"/></body></worldbody>
<actuator><general name="drive" joint="base" gainprm="0.002" biastype="affine" biasprm="0 0 -0.05"/></actuator></mujoco>"""
TIME = DT * np.arange(N)


def logged(folder, text, u):
    path = folder / "model.xml"
    path.write_text(text, encoding="utf-8")
    return path, simgap.simulate(path, u, dt=DT), np.random.default_rng(0)


@pytest.fixture
def motor(tmp_path):
    u = 80.0 * np.sin(2 * np.pi * (0.3 * TIME + 0.1 * TIME**2))
    path, run, rng = logged(tmp_path, MOTOR, u)
    return path, u, run.angle + 1e-4 * rng.standard_normal(N), run.velocity + 0.01 * rng.standard_normal(N)


def test_a_weak_servo_that_the_weight_keeps_from_its_target_has_no_wrong_unit(tmp_path):
    """kp / (kp + m g l) = 0.29: the model itself moves by that part of its command."""
    u = 0.8 * np.sin(2 * np.pi * 0.4 * TIME)
    path, run, rng = logged(tmp_path, WEAK, u)
    log = {"time_s": TIME, "command_rad": u, "angle_rad": run.angle + 2e-4 * rng.standard_normal(N)}
    check = simgap.check(log, path)
    assert check.verdict.value == "ready", check.problems
    assert [p.problem for p in simgap.check(log | {"angle_rad": np.degrees(log["angle_rad"])}, path).to_fix()]


@pytest.mark.parametrize("by", ["angle_rad", "velocity_rad_s"])
def test_a_motor_by_its_voltage_is_ready(motor, by):
    path, u, angle, velocity = motor
    check = simgap.check({"time_s": TIME, "ctrl": u, by: angle if by == "angle_rad" else velocity}, path)
    assert check.verdict.value == "ready", check.problems
    assert "back-EMF" in check.understood["servo"]


def test_a_motor_by_its_voltage_that_turns_the_other_way_has_a_sign(motor):
    path, u, angle, _ = motor
    found = simgap.check({"time_s": TIME, "ctrl": -u, "angle_rad": angle}, path).to_fix()
    assert [p.problem for p in found] == ["sign"]


def test_a_position_servo_needs_an_angle(tmp_path):
    path, run, _ = logged(tmp_path, WEAK, 0.5 * np.sin(TIME))
    with pytest.raises(InputError, match="a command and no angle"):
        simgap.check({"time_s": TIME, "command_rad": 0.5 * np.sin(TIME), "velocity_rad_s": run.velocity}, path)


def test_a_log_of_the_velocity_alone_is_replayed(motor, tmp_path):
    path, u, _, velocity = motor
    table = np.column_stack([TIME, u, velocity])
    np.savetxt(tmp_path / "v.csv", table, delimiter=",", header="time_s,ctrl,velocity_rad_s", comments="")
    ended = CliRunner().invoke(replay_command, [str(path), str(tmp_path / "v.csv"), "--out", str(tmp_path / "p.csv")])
    assert ended.exit_code == 0, ended.output
    assert "velocity" in ended.output


@pytest.mark.parametrize(("rows", "told"), [(2, False), (10, True)])
def test_a_channel_that_is_held_for_several_rows_is_named_with_its_period(rows, told):
    x = np.sin(TIME) + 0.01 * np.random.default_rng(0).standard_normal(N)
    fresh, problems = refreshed("velocity", "base", np.repeat(x[::rows], rows), DT)
    assert [p.problem for p in problems] == (["sample_and_hold"] if told else [])
    if told:
        assert problems[0].value == pytest.approx(rows * DT)
        assert len(fresh) == N // rows


def test_a_coarse_sensor_at_constant_speed_is_not_held():
    x = 0.01 * np.floor(TIME / (10 * DT) + 1e-9)
    assert refreshed("angle", "base", x, DT)[1] == []


def test_a_command_that_varies_by_rounding_alone_has_no_slope():
    assert relate(-7.0 + 1e-15 * np.arange(N), np.sin(TIME), DT) is None


def test_a_header_that_is_a_unit_of_speed_names_the_velocity():
    assert guess(["time_ms", "pwm", "rpm"])["velocity"] == ("rpm", "rpm")


def test_counts_with_a_gain_are_an_angle():
    assert Channel("theta", "1", 0.00314).factor("angle", "here") == 0.00314
    with pytest.raises(InputError, match="measures torque"):
        Channel("theta", "V").factor("angle", "here")


@pytest.mark.parametrize(("lines", "said"), [('hold = "held"', "as stated"), ("", "(assumed)")])
def test_a_hold_that_is_stated_is_not_assumed(tmp_path, lines, said):
    t = 0.002 * np.arange(2000)
    u = 0.3 * np.sin(2 * np.pi * (0.5 * t + 0.4 * t**2))
    path = tmp_path / "model.xml"
    path.write_text(MOTOR.replace(' biastype="affine" biasprm="0 0 -0.05"', "").replace("0.002", "1"), encoding="utf-8")
    run = simgap.simulate(path, 0.05 * u, dt=0.002)
    table = np.column_stack([t, 0.05 * u, run.velocity + 1e-3 * np.random.default_rng(0).standard_normal(2000)])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s", comments="")
    (tmp_path / "log.toml").write_text(f"[recording]\n{lines}\n", encoding="utf-8")
    assert any(said in text for text in simgap.check(tmp_path / "log.csv", path).understood.values())
