"""A gripper with a mirrored finger and a fixed tendon, from its log to corrected.xml."""

from __future__ import annotations

from pathlib import Path

import pytest

from diagnose.robot.options import RobotOptions
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.model import load_robot
from mjsim.robot.recording import load_robot_recording
from mjsim.robot.scenario import robot_scenario, run_robot, write_robot_log
from mjsim.robot.write import carried_effects
from simgap.robot import diagnose_robot_files
from tests.robot.test_scenario import GRIPPER

TOML = """model = "gripper.xml"
duration_s = 12
sample_time_s = 0.01
[excitation]
kind = "fourier"
harmonics = 8
speed_m_s = 0.1
[[effects]]
id = "coulomb_friction"
joint = "wrist"
torque_Nm = 0.4
[noise]
angle = 1e-5
"""


@pytest.mark.slow
def test_friction_beside_a_tied_finger_is_found_by_servo_and_corrected_xml_follows_the_log(tmp_path: Path) -> None:
    (tmp_path / "gripper.xml").write_text(GRIPPER)
    (tmp_path / "log.toml").write_text(TOML)
    path, _ = write_robot_log(run_robot(robot_scenario(tmp_path / "log.toml")), tmp_path / "logs")
    options = RobotOptions(effects=("coulomb_friction",))
    found = diagnose_robot_files([path], tmp_path / "gripper.xml", tmp_path / "out", options=options, page=False)
    assert [(f.effect, f.joint) for f in found.findings] == [("coulomb_friction", "wrist")]
    assert found.findings[0].parameters["torque_Nm"].value == pytest.approx(0.4, rel=0.02)
    corrected = load_robot(tmp_path / "out" / "corrected.xml")
    log = load_robot_recording(path, corrected)
    run = closed_loop(corrected, log, carried_effects(tmp_path / "out" / "corrected.xml"))
    assert abs(run.z - log.angle).max() < 2e-3
