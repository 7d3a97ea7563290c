"""Verdicts of servo joints rest on all joints together in MuJoCo, not on joint-wise fits alone."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from diagnose.result import FitFigures, Verdict
from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.motion import DIVERGED
from diagnose.robot.servos.pipeline import diagnose_servos
from diagnose.robot.servos.whole import is_explained, lowered, predictable
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, servo_mjcf, write_servo_log
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import load_robot
from mjsim.robot.recording import load_robot_recording
from simgap.robot_servos import given_runs, judge_servos, with_file_at_noise
from simgap.robot_written import write_corrected_servos

NOMINAL = ServoRobot(three_axes(), (ServoJoint(60.0, 6.0), ServoJoint(90.0, 8.0), ServoJoint(50.0, 4.0)))


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """Dry friction at the second joint: outcome of the search, robot, recordings, and the corrected file."""
    out = tmp_path_factory.mktemp("whole")
    (out / "arm.xml").write_text(servo_mjcf(NOMINAL))
    robot = load_robot(out / "arm.xml")
    logs = []
    for seed, name in ((1, "a"), (2, "b")):
        write_servo_log(NOMINAL.with_servo(1, friction=1.0), out / f"{name}.csv", seed, 8.0)
        logs.append(load_robot_recording(out / f"{name}.csv", robot, model=out / "arm.xml"))
    outcome = diagnose_servos(robot, logs[:1], logs[1:], RobotOptions(effects=("coulomb_friction",)))
    write_corrected_servos(out / "arm.xml", robot, outcome, out / "corrected.xml")
    return outcome, robot, logs, out


def test_verdicts_that_the_whole_robot_confirms_stand(rubbing):
    outcome, robot, logs, out = rubbing
    d = judge_servos(outcome, robot, out / "corrected.xml", logs[:1], logs[1:])
    assert [r.verdict for r in d.joints.values()] == [Verdict.NO_MISMATCH, Verdict.MISSING_PHYSICS, Verdict.NO_MISMATCH]
    assert d.verdict is Verdict.MISSING_PHYSICS


def test_missing_physics_needs_a_lower_held_out_error_in_the_closed_loop(rubbing):
    outcome, robot, logs, out = rubbing
    text = (out / "corrected.xml").read_text()
    level = mujoco.MjModel.from_xml_string(text).dof_frictionloss[1]
    spec = mujoco.MjSpec.from_string(text)
    spec.joint("joint2").frictionloss = 4 * level
    (out / "worse.xml").write_text(spec.to_xml())
    d = judge_servos(outcome, robot, out / "worse.xml", logs[:1], logs[1:])
    joint = d.joints["joint2"]
    assert joint.fit["corrected"].held_out_rms > joint.fit["nominal"].held_out_rms
    assert joint.verdict is d.verdict is Verdict.UNEXPLAINED
    assert [f.effect for f in joint.findings] == ["coulomb_friction"]
    assert "does not lower the held-out error" in joint.summary
    assert "Structure remains at joint2" in d.summary


def test_no_mismatch_needs_a_closed_loop_error_that_nothing_predicts(rubbing):
    """A corrected file with friction at the third joint that its search did not find."""
    outcome, robot, logs, out = rubbing
    spec = mujoco.MjSpec.from_string((out / "corrected.xml").read_text())
    spec.joint("joint3").frictionloss = 1.0
    (out / "other.xml").write_text(spec.to_xml())
    d = judge_servos(outcome, robot, out / "other.xml", logs[:1], logs[1:])
    assert outcome.diagnosis.joints["joint3"].verdict is Verdict.NO_MISMATCH
    assert d.joints["joint3"].verdict is Verdict.UNEXPLAINED
    assert "a black-box model predicts" in d.joints["joint3"].summary


def test_a_diverged_run_explains_nothing_and_lowers_nothing(rubbing):
    s = rubbing[0].searches[0]
    lost = np.full(len(s.problem.angle), np.nan)
    assert predictable(s, lost) == (1.0, 0.0)
    assert not is_explained(s, lost, (0.0, 1.0))
    good, bad = FitFigures(1.0, 1.0, 1.0, 1.0), FitFigures(math.nan, math.nan, math.nan, math.nan)
    assert lowered(bad, good)
    assert not lowered(good, bad)
    assert not lowered(good, dataclasses.replace(good))


def test_the_noise_is_a_threshold(rubbing):
    s = rubbing[0].searches[0]
    structure = np.sin(np.arange(len(s.problem.angle)) * 0.05)
    for size, expected in ((1.4, True), (1.6, False)):
        e = structure * size * s.problem.noise / float(np.sqrt(np.mean(structure[s.problem.held] ** 2)))
        e *= min(1.0, size * s.problem.noise / float(np.sqrt(np.mean(e[s.problem.fitted] ** 2)))) if expected else 1.0
        assert is_explained(s, e, (0.9, 0.0)) is expected
    assert is_explained(s, structure, (0.01, 0.0))
    white = np.random.default_rng(0).standard_normal(len(structure))
    assert is_explained(s, white, (0.9, 0.5))
    assert not is_explained(s, structure, (0.9, 0.5)), "held-out samples of a slow wave are too few independent ones to clear it"


def test_the_integration_error_halves_with_the_timestep(rubbing):
    _, robot, logs, _ = rubbing
    a, b, c = (closed_loop(robot, logs[0], (), 100, finer=k).z for k in (1, 2, 4))
    assert np.max(np.abs(b - c)) == pytest.approx(0.5 * np.max(np.abs(a - b)), rel=0.15)


def test_a_run_that_diverges_has_an_error_whose_square_is_a_number(rubbing):
    p = rubbing[0].searches[0].problem
    slots = p.nominal.copy()
    slots[SLOT["kv"]], slots[SLOT["kp"]] = -1e9, -1e9
    e = p.error(slots)
    assert np.max(np.abs(e)) <= DIVERGED * np.ptp(p.angle)
    assert math.isfinite(float(e @ e) ** 2)


def test_numbers_stay_where_the_file_as_given_leaves_noise(rubbing):
    outcome, robot, logs, _ = rubbing
    numbers = {n: dataclasses.replace(r, verdict=Verdict.PARAMETERS_ONLY) for n, r in outcome.diagnosis.joints.items()}
    lines = ("kp of joint1: 60 -> 61 N m/rad [60.5, 61.5]", "kp of joint2: 90 -> 99 N m/rad [98, 100]")
    d = dataclasses.replace(outcome.diagnosis, joints=numbers, changed=lines)
    runs, rng, quiet = given_runs(robot, logs), np.random.default_rng(0), []
    for r, run in zip(logs, runs, strict=True):  # joints 1 and 3 as the file has them
        angle = run.z + 1e-4 * rng.standard_normal(run.z.shape)
        angle[:, 1] = r.angle[:, 1]
        quiet.append(dataclasses.replace(r, angle=angle))
    kept = with_file_at_noise(dataclasses.replace(outcome, diagnosis=d), robot, runs, quiet).diagnosis
    assert kept.joints["joint1"].verdict is Verdict.NO_MISMATCH
    assert kept.joints["joint2"].verdict is Verdict.PARAMETERS_ONLY  # the dry friction that the file lacks
    assert kept.changed == lines[1:]
