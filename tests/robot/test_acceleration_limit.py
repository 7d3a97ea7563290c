"""Limited acceleration of the targets of a robot's servos: the slot of one joint's run, and all joints in MuJoCo."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.hold import shown_hold
from diagnose.robot.servos.library import servo_laws
from diagnose.robot.servos.motion import joint_problem, prepare
from diagnose.robot.servos.screening import screen
from diagnose.robot.servos.search import PROMISING
from diagnose.robot.servos.starts import own_numbers, start_fit
from diagnose.robot.servos.state import JointSearch, Structure
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording
from simgap.robot import diagnose_robot_recordings
from tests.mjsim.profile_logs import plain_profile, steps

ARM = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))
JOINTS = ("joint1", "joint2", "joint3")
DT, FINER = 0.02, 20
LIMITS = (3.0, 2.5, 4.0)  # [rad/s^2]


def arm(folder):
    path = folder / "arm.xml"
    path.write_text(servo_mjcf(ARM), encoding="utf-8")
    return path


def recorded(hold: str, seconds: float, seed: int, noise: float = 0.0, limit: float = math.inf) -> RobotRecording:
    """A log of plain MuJoCo with motors under controllers whose targets are on profiles of ``LIMITS``."""
    m = mujoco.MjModel.from_xml_string(ARM.arm.mjcf("arm"))
    m.opt.timestep = DT / FINER
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    t = np.arange(0.0, seconds, DT)
    if hold == "held":
        command = np.column_stack([steps(seconds, DT, 3 * seed + j, 0.5) for j in range(3)])
    else:
        command = command_for(ARM, rng, t, 0.15)
    kp, kv = np.array([[s.kp, s.kv] for s in ARM.servos]).T
    fine = np.column_stack([plain_profile(u, DT, DT / FINER, limit, a, hold) for u, a in zip(command.T, LIMITS, strict=True)])
    target, angle = 0.5 * (fine[:-1] + fine[1:]), np.empty_like(command)
    d.qpos[:] = command[0]
    for k in range(-50, len(t)):
        if k >= 0:
            angle[k] = d.qpos
        for j in range(FINER):
            d.ctrl[:] = kp * (target[max(k, 0) * FINER + j if k >= 0 else 0] - d.qpos) - kv * d.qvel
            mujoco.mj_step(m, d)
    angle += noise * rng.standard_normal(angle.shape)
    return RobotRecording(t, JOINTS, DT, angle, command=command, hold=hold, hold_stated=True, source=f"{seed}.csv")


@pytest.mark.parametrize(("hold", "limit"), [("held", 0.8), ("linear", math.inf)])
def test_a_run_has_the_profile_of_its_slots(tmp_path, hold, limit):
    robot, log = load_robot(arm(tmp_path)), recorded(hold, 5.0, 1, limit=limit)
    motion, carried = prepare(robot, log, held=False), []
    for name, a in zip(JOINTS, LIMITS, strict=True):
        problem = joint_problem(robot, [motion], name, split=False)
        p = problem.nominal.copy()
        without = np.std(problem.error(p))
        p[SLOT["acceleration"]] = a
        carried.append({"effect": "acceleration_limit", "joint": name, "parameters": {"limit_rad_s2": a}})
        if math.isfinite(limit):
            p[SLOT["slew"]] = limit
            carried.append({"effect": "velocity_limit", "joint": name, "parameters": {"limit_rad_s": limit}})
        assert np.std(problem.error(p)) < 0.05 * without
    errors = [np.std(closed_loop(robot, log, effects).z - log.angle, axis=0) for effects in ((), carried)]
    assert np.all(errors[1] < 0.05 * errors[0])


def test_its_screening_looks_beside_the_numbers_of_the_file(tmp_path):
    """Without it the servo's gain falls to a fiftieth, beside which its profile makes the error grow."""
    robot, log = load_robot(arm(tmp_path)), recorded("held", 6.0, 1)
    problem = joint_problem(robot, [prepare(robot, log, held=False)], "joint1", split=True)
    numbers = own_numbers(problem)
    begun = Structure((), start_fit(problem, numbers))
    assert begun.fit.slots[SLOT["kp"]] < 0.2 * problem.nominal[SLOT["kp"]]
    laws = servo_laws(problem, begun.fit.slots)
    s = JointSearch(problem, RobotOptions(), numbers, begun, begun, laws, 3)
    promised, _, slots = next(x for x in screen(s, begun, laws) if x[1].id == "acceleration_limit")
    assert promised > PROMISING * s.entry
    assert slots[SLOT["kp"]] == problem.nominal[SLOT["kp"]]


@pytest.mark.parametrize("hold", ["held", pytest.param("linear", marks=pytest.mark.slow)])
def test_the_hold_is_found_beside_it(tmp_path, hold):
    log = dataclasses.replace(recorded(hold, 6.0, 1, 2e-4), hold="held", hold_stated=False)
    assert shown_hold(load_robot(arm(tmp_path)), [log]) == hold


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["held", "linear"])
def test_it_is_named_at_every_joint(tmp_path, hold):
    logs = [recorded(hold, 15.0, seed, 2e-4) for seed in (1, 2)]
    found = diagnose_robot_recordings(logs[:1], arm(tmp_path), tmp_path / "out", logs[1:], RobotOptions(), page=False)
    assert sorted((f.joint, f.effect) for f in found.findings) == [(j, "acceleration_limit") for j in JOINTS]
    for f, a in zip(sorted(found.findings, key=lambda f: f.joint), LIMITS, strict=True):
        assert f.parameters["limit_rad_s2"].value == pytest.approx(a, rel=0.05)
    for name in JOINTS:
        fit = found.joints[name].fit
        assert fit["corrected"].held_out_rms < 0.1 * fit["nominal"].held_out_rms
