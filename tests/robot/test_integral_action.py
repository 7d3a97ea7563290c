"""Integral action of servos in robots: the slot of one joint's run and ``<pid ki>`` in MuJoCo beside a plant of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.robot.servos.motion import joint_problem, prepare
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, simulate
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.drives import joint_drives
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.write import write_robot
from mjsim.robot.write_servo import NewServo, can_be_pid
from simgap.robot import diagnose_robot_files

NOMINAL = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))
TRUE = NOMINAL.with_servo(1, integral=120.0)
DT = 0.01


def arm(folder, ki: float | None = None, name: str = "arm.xml"):
    """The robot's file; with ki, a ``<pid>`` at its second joint."""
    text = servo_mjcf(NOMINAL)
    if ki is not None:
        text = text.replace('<position name="servo2"', f'<pid name="servo2" input="pos" ki="{ki}"')
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def recorded(seconds: float) -> RobotRecording:
    """A log that begins half a second into the motion, with the integral as it stands there."""
    t = np.arange(0, seconds, DT)
    command = command_for(NOMINAL, np.random.default_rng(4), t)
    angle, cut = simulate(TRUE, command, DT), round(0.5 / DT)
    return RobotRecording(t[cut:] - t[cut], ("joint1", "joint2", "joint3"), DT, angle[cut:], command=command[cut:])


@pytest.fixture(scope="module")
def log():
    return recorded(6.0)


def test_a_joint_runs_with_the_integral_that_its_slot_has(tmp_path, log):
    robot = load_robot(arm(tmp_path))
    problem = joint_problem(robot, [prepare(robot, log, held=False)], "joint2", split=False)
    p = problem.nominal.copy()
    without = problem.error(p)
    p[SLOT["integral"]] = 120.0
    later = slice(100, None)  # a run begins at rest, and this log does not
    assert np.std(problem.error(p)[later]) < 0.03 * np.std(without[later])


def test_mujoco_begins_with_the_integral_that_suits_the_recording(tmp_path, log):
    robot = load_robot(arm(tmp_path, ki=120.0))
    assert [d.slots[SLOT["integral"]] for d in joint_drives(robot)] == [0.0, 120.0, 0.0]
    without = closed_loop(load_robot(arm(tmp_path, name="plain.xml")), log).z[:, 1] - log.angle[:, 1]
    error = closed_loop(robot, log).z[:, 1] - log.angle[:, 1]
    assert np.std(error[100:]) < 0.03 * np.std(without[100:])
    carried = {"effect": "servo_deadband", "joint": "joint3", "parameters": {"half_width_rad": 0.01}}
    stepped = closed_loop(robot, log, [carried]).z[:, 1] - log.angle[:, 1]
    assert np.std(stepped[100:]) < 0.05 * np.std(without[100:])


def test_it_is_written_at_the_actuator(tmp_path):
    path, out = arm(tmp_path), tmp_path / "corrected.xml"
    robot = load_robot(path)
    d = joint_drives(robot)[1]
    assert can_be_pid(robot.model, d.actuator, d.servo)
    new = dataclasses.replace(d.servo, kp=70.0, zero=0.01)
    write_robot(path, robot, out, robot.nominal - robot.fixed, {}, [], [NewServo(d.actuator, d.servo, new, None, 30.0)])
    again = joint_drives(load_robot(out))
    assert [d.slots[SLOT["integral"]] for d in again] == [0.0, 30.0, 0.0]
    assert again[1].servo == dataclasses.replace(new, zero=0.0), "a <pid> integrates the command itself"
    write_robot(out, load_robot(out), tmp_path / "twice.xml", robot.nominal - robot.fixed, {}, [],
                [NewServo(d.actuator, again[1].servo, dataclasses.replace(again[1].servo, kp=80.0))])  # fmt: skip
    assert joint_drives(load_robot(tmp_path / "twice.xml"))[1].slots[SLOT["integral"]] == 30.0


@pytest.mark.slow
def test_it_is_named_at_its_joint_and_stands_in_the_corrected_file(tmp_path):
    path, log = arm(tmp_path), recorded(24.0)
    columns = {"time_s": log.time}
    for k, name in enumerate(log.joints):
        columns |= {f"{name}.command_rad": log.command[:, k], f"{name}.angle_rad": log.angle[:, k]}
    rng = np.random.default_rng(1)
    table = np.column_stack(list(columns.values()))
    table[:, 2::2] += 1e-4 * rng.standard_normal((len(table), 3))
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(columns), comments="")
    result = diagnose_robot_files([tmp_path / "log.csv"], path, tmp_path / "out")
    assert [(f.effect, f.joint) for f in result.findings] == [("integral_action", "joint2")]
    assert result.findings[0].parameters["gain_Nm_rad_s"].value == pytest.approx(120.0, rel=0.03)
    assert joint_drives(load_robot(tmp_path / "out" / "corrected.xml"))[1].slots[SLOT["integral"]] == pytest.approx(
        120.0, rel=0.03
    )
