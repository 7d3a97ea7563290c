"""Servo stiffness and friction from command and position: known values back, and no scale where the load does not tell it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from diagnose.robot.servo import servo_by_gravity
from lab.robot.arm import three_axes
from lab.robot.cases import trajectory
from mjsim.errors import InputError
from mjsim.robot.model import robot_from
from mjsim.robot.recording import RobotRecording

KP, KV, FRICTION = 60.0, 6.0, 1.2


def recording(robot, level=FRICTION, seed=3, seconds=40.0):
    """A log at 100 Hz of servos whose command is what the law needs for a motion; the command acts without delay."""
    arm, dt = three_axes(), 0.01
    t = np.arange(0, seconds, dt)
    q, v, a = trajectory(arm, np.random.default_rng(seed), t, base=1 / seconds, harmonics=20)
    torque = arm.torque(q, v, a) + [x.rotor for x in arm.links] * a + level * np.sign(v)
    command = q + (torque + KV * v) / KP
    ahead = np.vstack([command[1:], command[-1:]])  # a held command acts half a sample late
    return RobotRecording(t, robot.joints, dt, q, command=0.5 * (command + ahead))


@pytest.fixture(scope="module")
def robot():
    return robot_from(mujoco.MjModel.from_xml_string(three_axes().mjcf("arm")))


def test_gravity_tells_stiffness_and_friction(robot):
    by_joint = {s.joint: s for s in servo_by_gravity(robot, [recording(robot)], 3.0)}
    for joint in ("joint2", "joint3"):
        s = by_joint[joint]
        assert s.kp.value == pytest.approx(KP, rel=0.02)
        assert s.friction.value == pytest.approx(FRICTION, rel=0.05)
        assert s.time.value == pytest.approx(KV / KP, rel=0.05)
        assert s.share > 0.99


def test_a_log_without_commands_is_refused(robot):
    r = recording(robot)
    with pytest.raises(InputError, match="no joint has a command"):
        servo_by_gravity(robot, [RobotRecording(r.time, r.joints, r.dt, r.angle)], 3.0)


def test_the_published_servo_of_the_so101_is_far_too_stiff(local_copy):
    from lab.robot.so101 import CUTOFF, so101_mjcf
    from mjsim.robot.recording import load_robot_recording

    path = local_copy("so101", "friction_gravity.parquet")
    pytest.importorskip("pyarrow")
    arm = robot_from(mujoco.MjModel.from_xml_string(so101_mjcf()), "so101")
    by_joint = {s.joint: s for s in servo_by_gravity(arm, [load_robot_recording(path, arm)], CUTOFF)}
    lift = by_joint["shoulder_lift"]
    assert 8 < lift.kp.value < 16
    assert 0.2 < lift.friction.value < 0.45
    assert lift.kp.ci95[1] < 998.22 / 40
