"""Errors of a servo joint are weighted by block: a stretch that no servo law follows does not decide the fit."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from diagnose.robot.servos.fit import BLOCK, block_scale, block_squares, block_weights, fit
from diagnose.robot.servos.motion import joint_problem, prepare
from diagnose.robot.servos.starts import own_numbers, start_fit
from diagnose.robot.servos.unfollowed import UNFOLLOWED, unfollowed, unfollowed_note
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, simulate
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import robot_from
from mjsim.robot.recording import RobotRecording

TRUE = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))
DT = 0.02


@pytest.fixture(scope="module")
def robot():
    return robot_from(mujoco.MjModel.from_xml_string(servo_mjcf(TRUE)))


@pytest.fixture(scope="module")
def problem(robot):
    """Joint 2 of a log of 48 s; the position is stopped where it was at 20 s until 26 s."""
    t = np.arange(0, 48.0, DT)
    command = command_for(TRUE, np.random.default_rng(4), t)
    q = simulate(TRUE, command, DT) + 1e-4 * np.random.default_rng(5).standard_normal((len(t), 3))
    stopped = (t > 20.0) & (t < 26.0)
    q[stopped, 1] = q[np.flatnonzero(stopped)[0], 1]
    r = RobotRecording(t, robot.joints, DT, q, command=command)
    return joint_problem(robot, [prepare(robot, r, False)], "joint2", True)


def test_blocks_end_with_each_recording(problem):
    n = len(problem.angle)
    two = dataclasses.replace(problem, starts=np.array([0, 700, n]))
    block = two.blocks(BLOCK)
    size = round(BLOCK / DT)
    assert block[0] == 0
    assert block[699] == 699 // size
    assert block[700] == block[699] + 1
    assert np.all(np.diff(block) >= 0)
    assert np.max(np.bincount(block)) == size


def test_a_block_has_a_bounded_influence_and_the_scale_is_that_of_most_blocks(problem):
    rng = np.random.default_rng(0)
    error = 1e-3 * rng.standard_normal(len(problem.angle))
    block = problem.blocks(BLOCK)
    even = block_weights(problem, error)
    assert block_scale(problem, error) == pytest.approx(1e-6, rel=0.3)
    assert np.max(even) < 1.3 * np.min(even)
    for size in (10.0, 1000.0):
        wrong = np.where(block == 1, size * error, error)
        weights = block_weights(problem, wrong)
        own = block_squares(problem, wrong * weights, problem.fitted)[0]
        assert block_scale(problem, wrong) == pytest.approx(1e-6, rel=0.3)
        assert own[1] < 2.5 * np.median(own[own > 0])


def test_an_error_below_the_noise_weighs_as_the_noise(problem):
    tiny = np.full(len(problem.angle), 1e-3 * problem.noise)
    assert block_scale(problem, tiny) == problem.noise**2


def test_a_stretch_against_a_stop_does_not_decide_the_fit(problem):
    numbers = own_numbers(problem)
    found = start_fit(problem, numbers)
    equal = fit(problem, numbers, problem.nominal, np.full(len(problem.angle), 1.0 / problem.noise))
    miss = [abs(np.log(x.slots[SLOT["kp"]] / 90.0)) for x in (found, equal)]
    assert miss[0] < 0.03
    assert miss[1] > 0.1
    ((source, a, b),) = unfollowed(problem, found.error)
    assert source == problem.sources[0][0]
    assert (a, b) == (20.0, 28.0)
    assert "does not follow 8 s of the log" in unfollowed_note(problem, found.error)


@pytest.mark.parametrize(("factor", "count"), [(0.99, 0), (1.01, 1)])
def test_a_stretch_is_named_from_its_threshold_on(problem, factor, count):
    block = problem.blocks(BLOCK)
    level = np.sqrt(UNFOLLOWED * factor)
    error = np.where(block == 2, level, 1.0) * 10 * problem.noise
    assert len(unfollowed(problem, error)) == count
    assert bool(unfollowed_note(problem, error)) is bool(count)
