"""Friction that goes with the motion of another joint: only numbers that the log determines are given."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.library import servo_laws
from diagnose.robot.servos.motion import joint_problem, prepare
from diagnose.robot.servos.search import search_joint
from diagnose.robot.servos.starts import own_numbers, start_fit
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, simulate
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording

ARM = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))
DT = 0.01


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    """The second joint, whose servo feels the dry friction of the first and no viscous one."""
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(servo_mjcf(ARM), encoding="utf-8")
    robot = load_robot(path)
    t = np.arange(0.0, 12.0, DT)
    command = command_for(ARM, np.random.default_rng(3), t)
    angle = simulate(ARM.with_servo(1, source=0, drag=0.9), command, DT)
    angle = angle + 2e-4 * np.random.default_rng(4).standard_normal(angle.shape)
    log = RobotRecording(t, robot.joints, DT, angle, command=command)
    return joint_problem(robot, [prepare(robot, log, False)], "joint2", True)


def test_dry_friction_of_another_joint_has_no_viscous_part(problem):
    numbers = own_numbers(problem)
    s = search_joint(problem, RobotOptions(effects=("coupled_transmission",)), 3, numbers, start_fit(problem, numbers))
    assert [law.key for law in s.now.laws] == ["coupled_transmission/dry<joint1"]
    (law,) = s.now.laws
    values = law.values({n.slot: x for n, x in zip(s.now.fit.numbers, s.now.fit.x, strict=True)})
    assert list(values) == ["torque_Nm"]
    assert values["torque_Nm"][0] == pytest.approx(0.9, rel=0.05)
    assert s.refusals["coupled_transmission/friction<joint1"] == "one of its numbers is not determined"


def test_a_limit_is_of_a_law_that_holds_its_numbers(problem):
    laws = {x.key: x for x in servo_laws(problem, problem.nominal)}
    limits = [x for x in laws.values() if x.limit_of]
    assert sorted(x.form for x in limits if x.source == "joint1") == ["dry", "viscous"]
    for x in limits:
        whole = laws[x.limit_of]
        assert (whole.id, whole.source, whole.limit_of) == (x.id, x.source, "")
        assert {n.slot for n in x.numbers} < {n.slot for n in whole.numbers}
