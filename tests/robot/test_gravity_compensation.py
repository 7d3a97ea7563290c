"""A controller that carries the weight of the links beside its servos, which the file does not say, or says without need."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.bodies import GRAVITY, body_numbers, gravcomp_of, is_physical
from diagnose.robot.servos.pipeline import diagnose_servos
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf
from mjsim.robot.along import along
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.shares import SERIES, compensation
from simgap.robot_servos import judge_servos
from simgap.robot_written import write_corrected_servos

ARM = ServoRobot(three_axes(), (ServoJoint(60.0, 6.0), ServoJoint(90.0, 8.0), ServoJoint(50.0, 4.0)))
DT = 0.02


def robot(folder, share: float):
    spec = mujoco.MjSpec.from_string(servo_mjcf(ARM))
    for body in spec.bodies[1:]:
        body.gravcomp = share
    path = folder / f"arm_{share:g}.xml"
    path.write_text(spec.to_xml())
    return load_robot(path), path


def log(given, seed: int, *, seconds: float = 12.0, noise: float = 2e-4) -> RobotRecording:
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, DT)
    command = command_for(ARM, rng, t, 0.1)
    empty = RobotRecording(t, given.joints, DT, np.repeat(command[:1], len(t), axis=0), command=command)
    z = closed_loop(given, empty).z
    return dataclasses.replace(empty, angle=z + noise * rng.standard_normal(z.shape), source=f"{seed}.csv")


@pytest.mark.slow
@pytest.mark.parametrize(("true", "file"), [(1.0, 0.0), (0.5, 0.0), (0.0, 1.0)])
def test_the_share_of_the_weight_is_found_and_written(tmp_path, true, file):
    plant, (given, path) = robot(tmp_path, true)[0], robot(tmp_path, file)
    logs = [log(plant, 1), log(plant, 2)]
    outcome = diagnose_servos(given, logs[:1], logs[1:], RobotOptions(effects=("torque_offset",)))
    found = outcome.masses.estimates[GRAVITY]
    assert found.ci95[0] <= true <= found.ci95[1]
    assert found.ci95[1] - found.ci95[0] < 0.2
    line = outcome.masses.lines[0]
    assert line.startswith("gravity compensation, the part of the links' weight that the drives carry beside their servos: ")
    assert f" {file:g} -> " in line
    corrected = tmp_path / "corrected.xml"
    write_corrected_servos(path, given, outcome, corrected)
    assert gravcomp_of(load_robot(corrected)) == pytest.approx(found.value, abs=1e-9)
    for joint in judge_servos(outcome, given, corrected, logs[:1], logs[1:]).joints.values():
        assert joint.fit["corrected"].held_out_rms < max(0.05 * joint.fit["nominal"].held_out_rms, 6e-4)
        assert not joint.findings


def test_what_is_carried_is_the_weight(tmp_path):
    given, lifted = robot(tmp_path, 0.0)[0], robot(tmp_path, 1.0)[0]
    z = 0.5 * np.random.default_rng(0).standard_normal((6, len(given.joints)))
    still = np.zeros_like(z)
    with_, without = along(lifted, z, still, still), along(given, z, still, still)
    for found in (compensation(given, z), compensation(lifted, z)):  # of the file that has it as well
        for k, name in enumerate(SERIES):
            difference = getattr(with_, name) - getattr(without, name)
            np.testing.assert_allclose(found[..., k], difference, rtol=1e-4, atol=1e-4, err_msg=name)


def test_no_controller_pushes_down_or_carries_twice_the_weight(tmp_path):
    given = robot(tmp_path, 0.0)[0]
    numbers = body_numbers(given)
    at = [n.kind for n in numbers].index(GRAVITY)
    for share, physical in ((1.0, True), (-0.5, False), (2.0, False)):
        x = np.zeros(len(numbers))
        x[at] = share
        assert is_physical(given, numbers, x) == physical
