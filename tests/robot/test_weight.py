"""Another weight about a joint: a number where the file has one about it, missing physics where it has none."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from diagnose.result import Verdict
from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.library import WEIGHT, servo_laws
from diagnose.robot.servos.motion import joint_problem, prepare
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, servo_mjcf, write_servo_log
from mjsim.robot.along import along
from mjsim.robot.model import robot_from
from mjsim.robot.recording import load_robot_recording
from mjsim.robot.rows import link_rows
from simgap.robot import diagnose_robot_files

NOMINAL = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("weight") / "a.csv"
    write_servo_log(NOMINAL, path, 3, 6.0)
    return path


def robot(gravity="0 0 -9.81"):
    spec = mujoco.MjSpec.from_string(servo_mjcf(NOMINAL))
    spec.option.gravity = [float(x) for x in gravity.split()]
    return robot_from(spec.compile())


def test_the_weight_is_the_torque_of_the_links_at_rest():
    r, z = robot(), np.random.default_rng(5).uniform(-1.0, 1.0, (4, 3))
    still = np.zeros_like(z)
    Y = link_rows(r, z, still, still)
    expected = np.einsum("nmlk,lk->nm", Y, r.nominal)
    weight = along(r, z, np.ones_like(z), np.ones_like(z)).weight
    assert np.allclose(weight, expected, atol=1e-9)
    assert np.allclose(along(robot("0 0 0"), z, still, still).weight, 0.0)


@pytest.mark.parametrize(("gravity", "bears"), [("0 0 -9.81", [False, True, True]), ("0 0 0", [False, False, False])])
def test_a_weight_is_a_number_where_the_file_has_one(log, gravity, bears):
    r = robot(gravity)
    motion = prepare(r, load_robot_recording(log, r), False)
    problems = [joint_problem(r, [motion], name, True) for name in r.joints]
    assert [p.bears_weight for p in problems] == bears
    for p in problems:
        (law,) = [x for x in servo_laws(p, p.nominal) if x.id == WEIGHT]
        assert law.number is p.bears_weight


def diagnosed(folder, centre=0.0, mass=1.0):
    """The diagnosis of an arm whose upper arm has its centre aside of its axis [m] and another mass (factor)."""
    link = NOMINAL.arm.links[1]
    x, y, z = link.centre
    true = ServoRobot(NOMINAL.arm.with_link(1, centre=(x, y, z + centre), mass=mass * link.mass), NOMINAL.servos)
    (folder / "arm.xml").write_text(servo_mjcf(NOMINAL))
    for seed, name in ((1, "a"), (2, "b")):
        write_servo_log(true, folder / f"{name}.csv", seed, 10.0)
    options = RobotOptions(effects=("coulomb_friction", "gravity_load", "gravity_compensation_spring"))
    return diagnose_robot_files([folder / "a.csv"], folder / "arm.xml", folder / "out", [folder / "b.csv"], options)


@pytest.mark.slow  # test_masses.py has the series and the covariance; a payload is fitted in test_servos.py
@pytest.mark.parametrize(("centre", "mass"), [(0.05, 1.0), (0.08, 1.2)])
def test_first_moment_and_inertia_of_a_link_are_found_and_no_weight_at_its_joint(tmp_path, centre, mass):
    """Its mass is not told: motion shows it by the first moment and the inertia alone."""
    d = diagnosed(tmp_path, centre, mass)
    assert not d.findings
    assert d.verdict is Verdict.PARAMETERS_ONLY
    link = NOMINAL.arm.links[1]
    x, _, z = link.centre
    moment = d.links["upper_arm.mz"]
    assert moment.value == pytest.approx(mass * link.mass * (z + centre), rel=0.01)
    assert moment.unit == "kg m"
    before, after = (link.inertia[1] + m * link.mass * (x**2 + c**2) for m, c in ((1.0, z), (mass, z + centre)))
    ratio = d.links["upper_arm.inertia / that of the file"]
    assert ratio.value == pytest.approx(after / before, rel=0.05)
    assert "upper_arm.mass" not in d.links
    assert any(x.startswith("first moment mz of upper_arm: 0.476 -> ") for x in d.changed)
    assert not any("kp of joint" in x for x in d.changed)
    for joint in d.joints.values():
        assert joint.fit["corrected"].held_out_rms < 3e-4
