"""Velocity feedforward of servos in robots: the slot of one joint's run, and what is carried beside MuJoCo's actuator."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.motion import joint_problem, prepare
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf
from mjsim.hold import between
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording
from simgap.robot import diagnose_robot_recordings

ARM = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))
DT, FINER, GAIN = 0.02, 20, 6.0


def arm(folder):
    path = folder / "arm.xml"
    path.write_text(servo_mjcf(ARM), encoding="utf-8")
    return path


def recorded(hold: str, seconds: float, seed: int, noise: float = 0.0) -> RobotRecording:
    """A log of plain MuJoCo with motors under controllers; that of the second joint has ``GAIN`` on its target's speed."""
    m = mujoco.MjModel.from_xml_string(ARM.arm.mjcf("arm"))
    m.opt.timestep = DT / FINER
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    t = np.arange(0.0, seconds, DT)
    command = command_for(ARM, rng, t, 0.1)
    kp, kv = np.array([[s.kp, s.kv] for s in ARM.servos]).T
    lead, angle = np.array([0.0, GAIN, 0.0]), np.empty_like(command)
    pairs = [between(u, DT, hold) for u in command.T]
    first, slope = (np.column_stack(x) for x in zip(*pairs, strict=True))
    jump = np.diff(command, axis=0, prepend=command[:1]) / DT if hold == "held" else slope
    d.qpos[:] = command[0]
    for k in range(-50, len(t)):
        i = max(k, 0)
        if k >= 0:
            angle[k] = d.qpos
        for j in range(FINER):
            target = first[i] + (slope[i] * (j + 0.5) * DT / FINER if k >= 0 else 0.0)
            d.ctrl[:] = kp * (target - d.qpos) - kv * d.qvel + (lead * jump[i] if k >= 0 else 0.0)
            mujoco.mj_step(m, d)
    angle += noise * rng.standard_normal(angle.shape)
    return RobotRecording(
        t, ("joint1", "joint2", "joint3"), DT, angle, command=command, hold=hold, hold_stated=True, source=f"{seed}.csv"
    )


@pytest.mark.parametrize("hold", ["held", "linear"])
def test_a_run_has_the_feedforward_of_its_slot(tmp_path, hold):
    robot, log = load_robot(arm(tmp_path)), recorded(hold, 6.0, 1)
    problem = joint_problem(robot, [prepare(robot, log, held=False)], "joint2", split=False)
    p = problem.nominal.copy()
    without = np.std(problem.error(p))
    p[SLOT["lead"]] = GAIN
    assert np.std(problem.error(p)) < 0.03 * without
    carried = {"effect": "velocity_feedforward", "joint": "joint2", "parameters": {"gain_Nms_rad": GAIN}}
    error = closed_loop(robot, log, [carried]).z[:, 1] - log.angle[:, 1]
    assert np.std(error) < 0.03 * without


@pytest.mark.slow
def test_it_is_named_at_its_joint(tmp_path):
    logs = [recorded("held", 15.0, seed, 1e-4) for seed in (1, 2)]
    found = diagnose_robot_recordings(logs[:1], arm(tmp_path), tmp_path / "out", logs[1:], RobotOptions(), page=False)
    assert [(f.effect, f.joint) for f in found.findings] == [("velocity_feedforward", "joint2")]
    assert found.findings[0].parameters["gain_Nms_rad"].value == pytest.approx(GAIN, rel=0.03)
    assert found.joints["joint2"].fit["corrected"].held_out_rms < 0.05 * found.joints["joint2"].fit["nominal"].held_out_rms
