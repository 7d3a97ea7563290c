"""Masses of links that all servo joints carry: series, robot-wide fit, ranking against each other and a payload."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from diagnose.result import Verdict
from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.agree import Masses
from diagnose.robot.servos.bodies import body_numbers, changes, is_physical
from diagnose.robot.servos.fit import covariance, fit
from diagnose.robot.servos.motion import joint_problem, prepare
from diagnose.robot.servos.starts import own_numbers
from lab.robot.servo_cases import nominal_robot
from lab.robot.servo_plant import ServoRobot, servo_mjcf, write_servo_log
from mjsim.robot.along import along
from mjsim.robot.model import robot_from
from mjsim.robot.recording import load_robot_recording
from mjsim.robot.shares import SERIES, shares
from simgap.robot import diagnose_robot_files

SIX, THREE = nominal_robot(6), nominal_robot(3)


def robot(servos):
    return robot_from(mujoco.MjModel.from_xml_string(servo_mjcf(servos)))


@pytest.fixture(scope="module")
def motion():
    rng = np.random.default_rng(0)
    return tuple(scale * rng.standard_normal((5, 6)) for scale in (0.5, 1.0, 2.0))


def test_links_that_are_given_again_change_nothing(motion):
    """Their principal axes are not those of the body, which MuJoCo would take where the file has them alike."""
    r = robot(SIX)
    file, again = along(r, *motion), along(r, *motion, r.nominal - r.fixed)
    for name in SERIES:
        np.testing.assert_allclose(getattr(again, name), getattr(file, name), rtol=1e-6, atol=1e-6)


def test_series_are_linear_in_the_inertial_numbers(motion):
    r = robot(SIX)
    numbers = body_numbers(r)
    assert [n.key for n in numbers[:4]] == ["column.mass", "column.mx", "column.my", "column.mz"]
    assert numbers[-1].key == "flange.payload"
    found, file = shares(r, *motion, changes(r, numbers)), along(r, *motion)
    for k, n in enumerate(numbers):
        more = along(r, *motion, r.nominal + 0.01 * n.scale * changes(r, numbers)[k])
        for i, name in enumerate(SERIES):
            expected = (getattr(more, name) - getattr(file, name)) / (0.01 * n.scale)
            np.testing.assert_allclose(found[:, :, k, i], expected, rtol=1e-3, atol=1e-3, err_msg=f"{n.key} {name}")


def test_a_joint_under_masses_has_them_in_its_series_and_its_covariance(tmp_path):
    write_servo_log(THREE, tmp_path / "a.csv", 3, 6.0)
    r = robot(THREE)
    m = prepare(r, load_robot_recording(tmp_path / "a.csv", r), False)
    p = joint_problem(r, [m], "joint2", True)
    x = np.zeros(len(body_numbers(r)))
    x[-1] = 0.5
    heavy = along(r, m.z, m.dz, np.zeros_like(m.z), r.nominal + 0.5 * changes(r, body_numbers(r))[-1])
    under = p.with_masses(x, np.diag(x) * 2e-4)
    np.testing.assert_allclose(under.series[:, 0], heavy.inertia[:, 1], rtol=1e-5)
    np.testing.assert_allclose(under.weight, heavy.weight[:, 1], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(under.as_given.series, p.series, rtol=1e-6, atol=1e-6)
    found = fit(p, own_numbers(p), p.nominal, np.full(len(p.angle), 1e3))
    known, open_ = (
        covariance(dataclasses.replace(p, masses_variance=v), found) for v in (0.0 * under.masses_variance, under.masses_variance)
    )
    assert np.linalg.eigvalsh(open_ - known)[0] > -1e-12
    assert open_[0, 0] > 1.01 * known[0, 0]


def test_a_link_stays_a_body():
    r = robot(THREE)
    numbers = body_numbers(r)
    x = np.zeros(len(numbers))
    assert is_physical(r, numbers, x)
    for key, value, physical in (("upper_arm.mass", -2.7, True), ("upper_arm.mass", -2.9, False), ("upper_arm.mz", 0.5, False)):
        x[:] = 0.0
        x[[n.key for n in numbers].index(key)] = value
        assert is_physical(r, numbers, x) is physical, key


def test_words_for_masses_that_cannot_be_told_apart():
    numbers = body_numbers(robot(THREE))
    at = {n.key: k for k, n in enumerate(numbers)}
    x, V = np.zeros(len(numbers)), 1e-4 * np.eye(len(numbers))
    x[at["forearm.mass"]] = 0.5

    def line(chosen, *others):
        return Masses(numbers, (at[chosen],), x, V, {at[chosen]: tuple(at[o] for o in others)}).lines[0].split(" (by")[0]

    assert line("forearm.mass") == "mass of forearm: 1.6 -> 2.1 kg [2.08, 2.12]"
    assert line("forearm.mass", "forearm.payload") == "payload or mass of forearm: +0.5 kg [+0.4804, +0.5196]"
    assert line("forearm.mass", "upper_arm.mass").endswith("[2.08, 2.12]; mass of upper_arm cannot be told from it")
    x[:] = 0.0
    x[at["forearm.payload"]] = 0.5
    assert line("forearm.payload") == "payload on forearm: +0.5 kg [+0.4804, +0.5196]"


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.7])
def test_the_mass_of_a_link_in_the_middle_is_found_and_leaves_the_gains(tmp_path, factor):
    link = SIX.arm.links[2]
    arm = SIX.arm.with_link(2, mass=factor * link.mass, inertia=tuple(factor * x for x in link.inertia))
    (tmp_path / "arm.xml").write_text(servo_mjcf(SIX))
    for seed, name in ((1, "a"), (2, "b")):
        write_servo_log(ServoRobot(arm, SIX.servos), tmp_path / f"{name}.csv", seed, 5.0, 100.0, base=0.125)
    options = RobotOptions(effects=("coulomb_friction", "gravity_load"))
    d = diagnose_robot_files([tmp_path / "a.csv"], tmp_path / "arm.xml", tmp_path / "out", [tmp_path / "b.csv"], options)
    assert not d.findings
    assert d.verdict is Verdict.PARAMETERS_ONLY
    assert list(d.links) == ["forearm.mass"]
    e = d.links["forearm.mass"]
    assert e.value == pytest.approx(factor * 2.8, rel=0.02)
    assert e.ci95[1] - e.ci95[0] < 0.1
    for joint, servo in zip(d.joints.values(), SIX.servos, strict=True):
        assert joint.linear_parameters["kp"].value == pytest.approx(servo.kp, rel=0.03)
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "corrected.xml"))
    assert written.body("forearm").mass[0] == pytest.approx(e.value)
