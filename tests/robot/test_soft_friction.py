"""Dry friction of servo robots that lets a loaded joint creep, as MuJoCo's default settings do, or that holds it at rest."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from diagnose.result import Verdict
from diagnose.robot.servos.motion import joint_problem, prepare
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.softness import friction_softness
from simgap.robot import diagnose_robot_recordings

DT, LEVELS, NOISE = 0.01, (0.8, 0.25), 1e-4
STIFF = 'solreffriction="-1 -1000" solimpfriction=".9999 .9999 .001 .5 2"'
STIFFER, FINE = STIFF.replace("1000", "5000"), 0.0002


def arm(levels=(0.0, 0.0), more="", timestep=0.001) -> str:
    """Two links in the plane of gravity; the servo of the second is fast, so that soft friction shows."""
    first, second = (f'frictionloss="{x}" {more}' if x else "" for x in levels)
    return f"""<mujoco><option timestep="{timestep}" integrator="implicitfast"/><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping=".2" armature=".02" {first}/>
<inertial pos=".15 0 0" mass="1.2" diaginertia=".002 .01 .01"/>
<body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0" damping=".02" armature=".004" {second}/>
<inertial pos=".1 0 0" mass=".4" diaginertia=".0005 .001 .001"/></body></body></worldbody>
<actuator><position name="s1" joint="shoulder" kp="80" kv="5"/><position name="s2" joint="elbow" kp="15" kv=".5"/></actuator>
</mujoco>"""


def recorded(xml: str, seed: int, seconds: float = 12.0, *, steps: bool = False) -> RobotRecording:
    m = mujoco.MjModel.from_xml_string(xml)
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    t = np.arange(round(seconds / DT)) * DT
    f, phase = rng.uniform(0.1, 0.8, (2, 5, 1)), rng.uniform(0, 2 * np.pi, (2, 5, 1))
    command = 0.25 * np.sin(2 * np.pi * f * t + phase).sum(axis=1).T
    command = command - command[0] * np.exp(-t / 0.3)[:, None]
    if steps:
        command = command[(t / 0.8).astype(int) * round(0.8 / DT)]
    angle, each = np.empty_like(command), round(DT / m.opt.timestep)
    for k in range(-100, len(t)):
        if k >= 0:
            angle[k] = d.qpos
        d.ctrl[:] = command[max(k, 0)]
        for _ in range(each):
            mujoco.mj_step(m, d)
    angle += NOISE * rng.standard_normal(angle.shape)
    return RobotRecording(
        t, ("shoulder", "elbow"), DT, angle, command=command, hold="held", hold_stated=True, source=f"{seed}.csv"
    )


def written(folder, text: str):
    path = folder / "arm.xml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_softness_is_that_of_mujocos_constraint(tmp_path):
    robot = load_robot(written(tmp_path, arm(LEVELS)))
    soft = friction_softness(robot)
    assert soft[:, 1] == pytest.approx(2 / (0.95 * 0.02))
    assert soft[:, 0] == pytest.approx(9.0 / robot.model.dof_invweight0), "impedance .9: R = (1 - d) / d of the inverse inertia"
    assert np.all(friction_softness(load_robot(written(tmp_path, arm(LEVELS, STIFF)))) == 0.0)


@pytest.mark.parametrize("more", ["", STIFFER])
def test_a_run_creeps_as_mujoco_does(tmp_path, more):
    robot, log = load_robot(written(tmp_path, arm(LEVELS))), recorded(arm(LEVELS, more, FINE), 1, 8.0, steps=True)
    problem = joint_problem(robot, [prepare(robot, log, held=False)], "elbow", split=False)
    errors = {}
    for soft in (True, False):
        p = problem.with_soft_friction(soft).nominal.copy()
        p[SLOT["friction"]] = LEVELS[1]
        errors[soft] = float(np.sqrt(np.mean(problem.error(p) ** 2)))
    assert errors[not more] < 0.5 * errors[bool(more)]


@pytest.mark.slow
@pytest.mark.parametrize("more", ["", STIFF])
def test_friction_of_either_kind_is_dry_friction(tmp_path, more):
    """Every joint at the noise in MuJoCo, nothing else named; corrected.xml has the kind of friction that the log shows."""
    logs = [recorded(arm(LEVELS, more), seed) for seed in (1, 2)]
    found = diagnose_robot_recordings(logs[:1], written(tmp_path, arm()), tmp_path / "out", logs[1:], page=False)
    assert found.verdict is Verdict.MISSING_PHYSICS
    assert sorted((f.joint, f.effect) for f in found.findings) == [(n, "coulomb_friction") for n in ("elbow", "shoulder")]
    for f, level in zip(sorted(found.findings, key=lambda f: f.joint), reversed(LEVELS), strict=True):
        assert f.parameters["torque_Nm"].value == pytest.approx(level, rel=0.05)
    assert all(r.fit["corrected"].held_out_rms < 1.5 * NOISE for r in found.joints.values())
    corrected = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "corrected.xml"))
    assert np.all((corrected.dof_solimp[:, 0] > 0.99) == bool(more))
