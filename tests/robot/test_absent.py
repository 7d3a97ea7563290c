"""Joints that are not in the log: taken to be held, which is said, and named where their neighbours show that they moved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from diagnose.check.types import LogVerdict
from diagnose.robot.check.absent import moved_unseen
from diagnose.robot.check.run import check_robot
from diagnose.robot.servos.positions import smoothed
from lab.robot.servo_cases import nominal_robot
from lab.robot.servo_plant import servo_mjcf
from mjsim.robot.recording import RobotRecording, load_robot_recording
from mjsim.robot.scenario import RobotLog, robot_scenario, run_robot, write_robot_log
from simgap.robot import diagnose_robot_recordings

RESTING = """model = "arm6"
duration_s = 20
sample_time_s = 0.01
[excitation]
kind = "fourier"
joints = ["joint1", "joint2", "joint4", "joint5", "joint6"]
[payload]
body = "flange"
mass = 1
[joints.joint1]
armature = 0.4
[[effects]]
id = "stribeck_friction"
joint = "joint2"
torque_Nm = 2
extra_static_torque_Nm = 2
stribeck_velocity_rad_s = 0.2
[noise]
angle = 2e-5
torque = 0.02
"""


def without(log: RobotLog, joint: str, channel: str = "torque") -> RobotRecording:
    """The log of a scenario without the columns of a joint."""
    robot, c = log.robot, log.columns
    names = tuple(n for n in robot.joints if n != joint)
    unit = {"torque": "Nm", "command": "rad"}[channel]
    given = np.column_stack([c[f"{n}.{channel}_{unit}"] for n in names])
    angle = np.column_stack([c[f"{n}.angle_rad"] for n in names])
    dt = float(c["time_s"][1] - c["time_s"][0])
    return RobotRecording(c["time_s"], names, dt, angle, held_at=((joint, 0.0),), source="log.csv", **{channel: given})


@pytest.fixture(scope="module")
def moving() -> RobotLog:
    return run_robot(robot_scenario("arm6_friction", sample_time_s=0.01))


@pytest.mark.slow
@pytest.mark.parametrize("joint", ["joint1", "joint3", "joint5"])
def test_a_joint_that_moved_unseen_is_named_by_torque(moving: RobotLog, joint: str) -> None:
    r = without(moving, joint)
    found = moved_unseen(moving.robot, r, *smoothed(moving.robot, r))
    assert found is not None
    assert found.joint == joint
    assert found.share > 0.5
    checked = check_robot(moving.robot, [r])
    assert checked.verdict is LogVerdict.FIX
    problem = next(p for p in checked.problems if p.problem == "not_logged")
    assert f"{joint} is not in the log and is taken to be held at 0 rad, but it moved" in problem.sentence
    assert "absence is the likely cause" in problem.sentence


def test_a_joint_that_moved_unseen_is_named_by_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mjsim.robot.exciting.ROUNDS", 2)
    (tmp_path / "servo.xml").write_text(servo_mjcf(nominal_robot(6)))
    log = run_robot(robot_scenario(tmp_path / "servo.xml", sample_time_s=0.01, duration_s=10.0))
    r = without(log, "joint3", "command")
    found = moved_unseen(log.robot, r, *smoothed(log.robot, r))
    assert found is not None
    assert found.joint == "joint3"


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["stribeck_friction", "torque_ripple"])
def test_a_joint_that_rested_is_only_said_to_be_held(effect: str, tmp_path: Path) -> None:
    """A payload, another armature and an effect at a neighbour are no motion of the joint that is not logged."""
    text = RESTING
    if effect == "torque_ripple":
        a, b = text.index("[[effects]]"), text.index("[noise]")
        law = '[[effects]]\nid = "torque_ripple"\njoint = "joint4"\namplitude_Nm = 1\ncycles_per_rev = 7\nphase_rad = 1\n'
        text = text[:a] + law + text[b:]
    (tmp_path / "mine.toml").write_text(text)
    log = run_robot(robot_scenario(tmp_path / "mine.toml"))
    r = without(log, "joint3")
    assert moved_unseen(log.robot, r, *smoothed(log.robot, r)) is None
    checked = check_robot(log.robot, [r])
    problem = next(p for p in checked.problems if p.problem == "not_logged")
    assert problem.severity.value == "limits"
    assert "joint3 is not in the log: it is taken to be held at 0 rad" in problem.sentence


@pytest.mark.slow
def test_a_diagnosis_says_that_the_absence_is_the_likely_cause(tmp_path: Path) -> None:
    log = run_robot(robot_scenario("arm3_nominal", duration_s=12.0, sample_time_s=0.01))
    path, _ = write_robot_log(log, tmp_path)
    lines = path.read_text().splitlines()
    keep = [i for i, n in enumerate(lines[0].split(",")) if not n.startswith("joint2.")]
    path.write_text("\n".join(",".join(line.split(",")[i] for i in keep) for line in lines) + "\n")
    r = load_robot_recording(path, log.robot)
    found = diagnose_robot_recordings([r], robot_scenario("arm3").model_path, tmp_path / "out", page=False)
    assert any("joint2 is not in the log" in n and "absence is the likely cause" in n for n in found.notes)
    assert not any(n.startswith("Joint joint2 is not in the log: it is held") for n in found.notes)
    assert found.summary.startswith("joint2 is not in the log and moved, the likely cause of what is found beside it.")
