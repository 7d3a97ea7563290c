"""Drives of MuJoCo 4 in robots: a ``<pid>`` with several controls runs as the ``<position>`` that it is, and is written back."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, simulate
from mjsim.errors import InputError
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.drives import joint_drives
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.write import write_robot
from mjsim.robot.write_servo import NewServo, can_slew

NOMINAL = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))
DT = 0.01


def pids(folder, more: str = "", name: str = "pid.xml"):
    """The robot's file with a ``<pid>`` in place of each ``<position>``, and a passive actuator ahead of them."""
    text = servo_mjcf(NOMINAL)
    assert text.count("<position") == 3
    text = text.replace("<position", f"<pid {more}")
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def log():
    t = np.arange(0, 4.0, DT)
    command = command_for(NOMINAL, np.random.default_rng(4), t)
    return RobotRecording(t, ("joint1", "joint2", "joint3"), DT, simulate(NOMINAL, command, DT), command=command)


def test_pids_with_two_controls_run_as_the_positions_that_they_are(tmp_path, log):
    (tmp_path / "arm.xml").write_text(servo_mjcf(NOMINAL), encoding="utf-8")
    as_position, as_pid = load_robot(tmp_path / "arm.xml"), load_robot(pids(tmp_path))
    assert (as_pid.model.nu, as_pid.model.nactuator) == (6, 3)
    for a, b in zip(joint_drives(as_position), joint_drives(as_pid), strict=True):
        assert a.servo == b.servo
        np.testing.assert_array_equal(a.slots, b.slots)
        assert (a.idle, b.idle) == ((), ("vel",))
    np.testing.assert_allclose(closed_loop(as_pid, log).z, closed_loop(as_position, log).z, atol=1e-12)
    carried = {"effect": "servo_deadband", "joint": "joint2", "parameters": {"half_width_rad": 0.05}}
    np.testing.assert_allclose(closed_loop(as_pid, log, [carried]).z, closed_loop(as_position, log, [carried]).z, atol=1e-12)


def test_a_slewed_setpoint_is_a_slot_and_stands_in_the_file(tmp_path, log):
    robot = load_robot(pids(tmp_path, 'slewmax="0.4"'))
    assert [d.slots[SLOT["slew"]] for d in joint_drives(robot)] == [0.4] * 3
    slewed = simulate(NOMINAL.with_servo(0, slew=0.4).with_servo(1, slew=0.4).with_servo(2, slew=0.4), log.command, DT)
    free = closed_loop(load_robot(pids(tmp_path, name="free.xml")), log).z
    error = closed_loop(robot, log).z - slewed
    assert np.std(error) < 0.05 * np.std(free - slewed)


@pytest.mark.parametrize("more", [None, "", 'input="pos"', 'slewmax="3"'])
def test_gains_and_a_velocity_limit_are_written_at_the_actuator(tmp_path, log, more):
    path = tmp_path / "arm.xml"
    if more is None:
        path.write_text(servo_mjcf(NOMINAL), encoding="utf-8")
    else:
        path = pids(tmp_path, more)
    robot, out = load_robot(path), tmp_path / "corrected.xml"
    d = joint_drives(robot)[1]
    assert can_slew(robot.model, d.actuator, d.servo)
    new = dataclasses.replace(d.servo, kp=70.0, kv=5.0, zero=0.01)
    write_robot(path, robot, out, robot.nominal - robot.fixed, {}, [], [NewServo(d.actuator, d.servo, new, 0.5)])
    again = load_robot(out)
    found = joint_drives(again)[1]
    assert found.servo == new
    assert found.slots[SLOT["slew"]] == 0.5
    assert found.idle == d.idle
    assert joint_drives(again)[0].servo == joint_drives(robot)[0].servo
    changed = NOMINAL.with_servo(1, kp=70.0, kv=5.0, slew=0.5)
    shifted = np.array(log.command)
    shifted[:, 1] -= 0.01
    truth = simulate(changed, shifted, DT)[:, 1]
    error = closed_loop(again, log).z[:, 1] - truth
    assert np.std(error[100:]) < 0.05 * np.std((closed_loop(robot, log).z[:, 1] - truth)[100:])


def test_inputs_that_no_log_holds_and_other_laws_are_refused(tmp_path):
    for more, said in (('input="pos ff"', "inputs pos ff"), ('ki="2"', "integral action")):
        with pytest.raises(InputError, match=said):
            joint_drives(load_robot(pids(tmp_path, more)))


def test_a_passive_actuator_ahead_of_the_drives_shifts_no_control(tmp_path, log):
    text = servo_mjcf(NOMINAL).replace(
        "<actuator>", '<actuator><dcmotor name="still" joint="joint3" input="none" resistance="1" motorconst="0 0"/>', 1
    )
    (tmp_path / "with.xml").write_text(text, encoding="utf-8")
    (tmp_path / "arm.xml").write_text(servo_mjcf(NOMINAL), encoding="utf-8")
    robot = load_robot(tmp_path / "with.xml")
    assert robot.model.nactuator == 4
    assert mujoco.mj_name2id(robot.model, mujoco.mjtObj.mjOBJ_ACTUATOR, "still") == 0
    np.testing.assert_allclose(closed_loop(robot, log).z, closed_loop(load_robot(tmp_path / "arm.xml"), log).z, atol=1e-12)
