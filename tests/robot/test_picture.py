"""The picture of a robot in its report, and how changed numbers are printed there."""

from __future__ import annotations

import mujoco
import numpy as np

from diagnose.report.figures import prose
from diagnose.robot.picture import _widest
from lab.robot.arm import three_axes
from mjsim.robot.model import robot_from


def test_the_pose_is_drawn_in_which_the_bodies_reach_farthest_apart():
    robot = robot_from(mujoco.MjModel.from_xml_string(three_axes().mjcf("arm")))
    poses = np.array([[0.0, 1.6, 2.0], [0.0, 1.0, 0.5], [0.0, 0.0, 0.0], [0.0, 1.7, 0.0]])
    assert np.array_equal(_widest(robot, poses), poses[2]), "upright the arm is tallest"


def test_an_arrow_is_printed_as_one_and_stays_with_the_number_before_it():
    assert prose("flange: 0.6 -> 1.6 kg") == "flange: 0.6\N{NO-BREAK SPACE}\N{RIGHTWARDS ARROW} 1.6\N{NO-BREAK SPACE}kg"
