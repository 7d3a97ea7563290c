"""Contact along a recording: samples with a contact force are found, left out by force and by servo, and said."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from diagnose.result import Verdict
from diagnose.robot.check.run import check_robot
from diagnose.robot.contact import contact_notes, stretches
from diagnose.robot.pipeline import diagnose_robot
from diagnose.robot.servos.pipeline import diagnose_servos
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, servo_mjcf
from mjsim.errors import InputError
from mjsim.robot.exciting import Limits, exciting
from mjsim.robot.model import robot_from
from mjsim.robot.recording import RobotRecording
from mjsim.robot.scenario import robot_scenario, run_robot
from mjsim.robot.touching import Touching, touching

CEILING = '<geom name="ceiling" type="plane" pos="0 0 {}" zaxis="0 0 -1" size="1 1 .1" contype="1" conaffinity="1"/>'
TOOL = 'name="tool" contype="1" conaffinity="1" '


def with_ceiling(xml: str, height: float) -> str:
    """An arm whose tool meets a plane above it."""
    return xml.replace('<body name="column"', CEILING.format(height) + '<body name="column"').replace('name="tool" ', TOOL)


@pytest.fixture(scope="module")
def pressed():
    """A robot under a ceiling, and its log by MuJoCo's inverse dynamics: the contact's force is in the torque."""
    robot = robot_from(mujoco.MjModel.from_xml_string(with_ceiling(three_axes().mjcf("arm"), 0.88)))
    t = np.arange(0, 20, 0.004)
    e = exciting(
        robot_from(mujoco.MjModel.from_xml_string(three_axes().mjcf("arm"))), np.random.default_rng(3), t, 0.05, 10, Limits()
    )
    data, torque, touched = mujoco.MjData(robot.model), np.empty_like(e.z), np.zeros(len(t), bool)
    for k in range(len(t)):
        data.qpos[:], data.qvel[:], data.qacc[:] = e.z[k], e.dz[k], e.ddz[k]
        mujoco.mj_inverse(robot.model, data)
        torque[k], touched[k] = data.qfrc_inverse, np.any(np.asarray(data.efc_force) > 0)
    noise = np.random.default_rng(0)
    torque = torque * (1 + 1e-3 * noise.standard_normal(torque.shape))
    z = e.z + 2e-5 * noise.standard_normal(e.z.shape)
    return robot, RobotRecording(t, robot.joints, 0.004, z, torque=torque, hold="linear", source="log.csv"), e, touched


def test_samples_with_a_contact_force_are_found_for_the_joints_that_feel_it(pressed):
    robot, _, e, touched = pressed
    assert 0.03 < touched.mean() < 0.4
    found = touching(robot, e.z, e.dz, e.ddz, 0.004)
    assert np.mean(found.rows[:, 1] == touched) > 0.99
    assert [p[:2] for p in found.pairs] == [("world", "forearm")]
    assert np.array_equal(found.rows[:, 0], found.rows[:, 2])
    own = robot_from(mujoco.MjModel.from_xml_string(three_axes().mjcf("arm")))
    assert not touching(own, e.z, e.dz, e.ddz, 0.004).rows.any()


def test_rows_are_widened_to_both_sides():
    rows = np.zeros((10, 1), bool)
    rows[4] = True
    assert np.flatnonzero(Touching(rows).widened(1, 3)[:, 0]).tolist() == [3, 4, 5, 6, 7]
    assert Touching(rows).widened(9, 9).all()
    assert not Touching(np.zeros((3, 2), bool)).widened(2, 2).any()
    assert stretches(np.array([1, 0, 1, 1], bool), 0.5) == [(1.0, 2.0), (0.0, 0.5)]


@pytest.mark.slow
def test_by_force_contact_is_left_out_and_said(pressed):
    robot, log, _, _ = pressed
    found = diagnose_robot(robot, [log]).diagnosis
    assert found.verdict is Verdict.NO_MISMATCH
    note = next(n for n in found.notes if n.startswith("Contact in log.csv"))
    assert "world and forearm" in note
    assert "joint1, joint2, joint3 are not compared" in note
    blind = robot_from(mujoco.MjModel.from_xml_string(three_axes().mjcf("arm")))
    assert diagnose_robot(blind, [log]).diagnosis.verdict is not Verdict.NO_MISMATCH, "without the ceiling its force is physics"


def test_a_check_says_where_contact_is(pressed):
    robot, log, _, touched = pressed
    found = check_robot(robot, [log])
    contact = next(p for p in found.problems if p.problem == "contact")
    assert contact.value == pytest.approx(touched.mean(), abs=0.01)
    assert "world and forearm" in contact.sentence
    assert len(contact.marks) >= 1


def test_a_log_in_contact_throughout_is_refused_by_name(pressed):
    robot, log, e, _ = pressed
    data, tool = mujoco.MjData(robot.model), robot.model.geom("tool").id
    heights = []
    for q in e.z:
        data.qpos[:] = q
        mujoco.mj_kinematics(robot.model, data)
        heights.append(float(data.geom_xpos[tool, 2]))
    height = float(np.percentile(heights, 3)) + 0.045  # the tool's radius
    low = robot_from(mujoco.MjModel.from_xml_string(with_ceiling(three_axes().mjcf("arm"), height)))
    found = touching(low, e.z, e.dz, e.ddz, 0.004)
    assert 0.9 < found.rows.mean() < 1
    with pytest.raises(InputError, match=r"out of contact.*<exclude>"):
        diagnose_robot(low, [log])


def test_bodies_that_overlap_at_every_sample_are_taken_for_the_models_shape(pressed):
    _, _, e, _ = pressed
    xml = three_axes().mjcf("arm").replace('<geom name="pedestal" ', '<geom name="pedestal" contype="1" conaffinity="1" ')
    xml = xml.replace('material="shell"/>', 'material="shell" contype="1" conaffinity="1"/>', 1)
    deep = robot_from(mujoco.MjModel.from_xml_string(xml))
    found = touching(deep, e.z, e.dz, e.ddz, 0.004)
    assert found.always == (("world", "column"),)
    assert not found.rows.any()
    said = contact_notes(deep, [("log.csv", found, 0.004)])
    assert len(said) == 1
    assert "world and column overlap at every sample" in said[0]


@pytest.mark.slow
def test_by_servo_contact_is_left_out_and_said(tmp_path: Path):
    servos = ServoRobot(three_axes(), (ServoJoint(60.0, 6.0), ServoJoint(90.0, 8.0), ServoJoint(50.0, 4.0)))
    free, under = tmp_path / "free.xml", tmp_path / "under.xml"
    free.write_text(servo_mjcf(servos))
    under.write_text(with_ceiling(servo_mjcf(servos), 0.86))
    asked = run_robot(robot_scenario(free, duration_s=20.0, sample_time_s=0.01))
    from mjsim.robot.closed_loop import closed_loop
    from mjsim.robot.model import load_robot

    robot = load_robot(under)
    names = [f"{n}.command_rad" for n in robot.joints]
    command = np.column_stack([asked.columns[n] for n in names])
    start = np.column_stack([asked.columns[f"{n}.angle_rad"] for n in robot.joints])
    log = RobotRecording(asked.columns["time_s"], robot.joints, 0.01, start, command=command, source="log.csv")
    run = closed_loop(robot, log)
    step = 2 * np.pi / 16384
    log = RobotRecording(log.time, robot.joints, 0.01, step * np.round(run.z / step), command=command, source="log.csv")
    outcome = diagnose_servos(robot, [log])
    note = next(n for n in outcome.diagnosis.notes if n.startswith("Contact in log.csv"))
    assert "world and forearm" in note
    p = outcome.searches[1].problem
    rows = touching(robot, run.z, run.dz, np.gradient(run.dz, 0.01, axis=0), 0.01).rows[:, 1]
    assert 0.02 < rows.mean() < 0.5
    assert not np.any((p.fitted | p.held)[rows])
    assert all(not r.findings for r in outcome.diagnosis.joints.values())
