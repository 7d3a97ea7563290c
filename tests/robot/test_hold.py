"""How the commands of a servo robot go between samples, by a plant that shares no law with the fits."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from diagnose.fit.command_hold import is_assumed, with_hold
from diagnose.robot.servos.hold import shown_hold
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, simulate
from mjsim.hold import within
from mjsim.robot.model import robot_from
from mjsim.robot.recording import RobotRecording

DT, FINER = 0.04, 8
NOMINAL = ServoRobot(three_axes(), (ServoJoint(60.0, 6.0), ServoJoint(90.0, 8.0), ServoJoint(50.0, 4.0)))


@pytest.fixture(scope="module")
def robot():
    return robot_from(mujoco.MjModel.from_xml_string(servo_mjcf(NOMINAL)))


def log(robot, hold: str, friction: float = 0.0, seconds: float = 12.0) -> RobotRecording:
    true = NOMINAL.with_servo(1, friction=friction, kp=1.2 * NOMINAL.servos[1].kp)
    t = np.arange(0.0, seconds, DT)
    command = command_for(true, np.random.default_rng(3), t, 0.1, 12)
    fine = np.column_stack([within(u, DT, hold, FINER) for u in command.T])
    angle = simulate(true, fine, DT / FINER)[::FINER]
    angle = angle + 1e-4 * np.random.default_rng(0).standard_normal(angle.shape)
    return RobotRecording(t, robot.joints, DT, angle, command=command)


@pytest.mark.parametrize(
    ("hold", "friction"),
    [
        ("held", 1.0),
        pytest.param("linear", 0.0, marks=pytest.mark.slow),
        pytest.param("linear", 1.0, marks=pytest.mark.slow),
        pytest.param("mean", 0.0, marks=pytest.mark.slow),
    ],
)
def test_the_hold_of_all_commands_is_found(robot, hold, friction):
    assert shown_hold(robot, [log(robot, hold, friction)]) == hold


@pytest.mark.slow
def test_long_logs_are_fitted_by_windows(robot, monkeypatch):
    for module in ("hold", "starts"):
        monkeypatch.setattr(f"diagnose.robot.servos.{module}.THIN", 600)
    assert shown_hold(robot, [log(robot, "linear", 1.0, 60.0)]) == "linear"


def test_a_stated_hold_stays(robot):
    given = log(robot, "held")
    assert is_assumed([given])
    assert not is_assumed([dataclasses.replace(given, hold_stated=True)])
    assert [r.hold for r in with_hold([given], "linear")] == ["linear"]
