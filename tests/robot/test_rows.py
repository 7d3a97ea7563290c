"""Robots from MJCF: inverse dynamics linear in the links' parameters, against MuJoCo, and what is refused."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from lab.robot.arm import six_axes, three_axes
from mjsim.errors import InputError
from mjsim.robot.inertia import from_body, moved, point_mass, pseudo_inertia, to_body, unpack_pseudo_inertia
from mjsim.robot.model import robot_from
from mjsim.robot.rows import check_rows, inertia_along, link_rows, mujoco_torque, nominal_torque

# a tree with all that is handled: tilted gravity, a slide, two joints in one body, joints off the origin, a welded part,
# gravity compensation, a spring
TREE = """<mujoco><option gravity="1 2 -9"/><worldbody>
<body pos="0 .1 .2" euler="10 20 30"><joint name="a" axis="0 0 1" armature=".1" damping="2"/>
 <geom size=".1 .2" type="capsule" pos=".1 .2 .3"/>
 <body pos=".3 0 0" euler="90 0 10"><joint name="b" axis="1 0 1" pos=".1 .2 0" stiffness="3" springref="10"/>
  <geom size=".1 .2 .3" type="box" pos=".1 .2 .3"/>
  <body pos=".1 0 0" euler="0 50 0"><geom size=".05" pos=".1 0 0"/></body>
  <body name="c" pos=".3 0 .4" euler="0 90 10"><joint name="c" type="slide" axis="0 1 1"/>
   <joint name="d" pos="0 0 .1" axis="1 1 1"/><geom size=".1 .2 .3" type="ellipsoid" pos=".1 .2 .3" euler="4 5 6"/>
   <body gravcomp="1" pos=".1 0 0"><joint name="e" axis="0 1 0"/><geom size=".05 .1" type="cylinder" pos=".1 0 0"/></body>
  </body></body></body></worldbody>
<actuator><motor joint="a" gear="10"/></actuator>{}</mujoco>"""
TIE = '<equality><joint joint1="e" joint2="b" polycoef=".1 -2 0 0 0"/></equality>'


def tree(extra=""):
    return robot_from(mujoco.MjModel.from_xml_string(TREE.format(extra)))


@pytest.mark.parametrize(("extra", "count"), [("", 5), (TIE, 4)])
def test_the_rows_are_those_of_mujoco(extra, count):
    robot = tree(extra)
    assert len(robot.joints) == count
    assert robot.gear[0] == 10
    assert check_rows(robot, 20) < 1e-12


def test_a_joint_may_follow_one_that_follows_and_one_may_be_locked():
    more = '<joint joint1="d" joint2="e" polycoef="0 .5 0 0 0"/><joint joint1="c" polycoef=".2 0 0 0 0"/></equality>'
    robot = tree(TIE.replace("</equality>", more))
    assert robot.joints == ("a", "b")
    assert_allclose(robot.tie, [[1, 0], [0, 1], [0, 0], [0, -1], [0, -2]])
    assert_allclose(robot.rest, [0, 0, 0.2, 0.05, 0.1])
    assert check_rows(robot, 20) < 1e-12


def test_a_tendon_of_tied_joints_drives_the_one_that_they_follow():
    pull = FIXED.format('<joint joint="b" coef="3"/><joint joint="e" coef="1"/>').replace("<motor ", '<motor gear="2" ')
    robot = tree(TIE + pull)
    assert_allclose(robot.gear, [10, 2 * (3 - 2), 1, 1])
    assert robot.actuators == (0, 1, -1, -1)
    assert_allclose(robot.length, [0, 2 * 0.1, 0, 0])
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.tie @ [0.1, 0.2, 0.3, 0.4] + robot.rest
    mujoco.mj_forward(robot.model, data)
    assert data.actuator_length[1] == pytest.approx(2 * 0.2 + 2 * 0.1)


@pytest.mark.parametrize("arm", [three_axes(), six_axes()], ids=["three", "six"])
def test_the_rows_are_those_of_the_other_plant(arm):
    robot = robot_from(mujoco.MjModel.from_xml_string(arm.mjcf("arm")))
    rng = np.random.default_rng(3)
    z, dz, ddz = (rng.standard_normal((30, len(arm.links))) for _ in range(3))
    theirs = arm.torque(z, dz, ddz) + [x.rotor for x in arm.links] * ddz + [x.viscous for x in arm.links] * dz
    assert_allclose(nominal_torque(robot, z, dz, ddz), theirs, rtol=1e-10, atol=1e-11)
    assert_allclose(mujoco_torque(robot, z, dz, ddz), theirs, rtol=1e-9, atol=1e-10)


def test_the_inertia_of_a_joint_is_the_diagonal_of_mujocos():
    robot = tree()
    z = np.random.default_rng(1).standard_normal((4, 5))
    data = mujoco.MjData(robot.model)
    for q, row in zip(z, inertia_along(robot, z), strict=True):
        data.qpos[:] = q
        mujoco.mj_forward(robot.model, data)
        full = np.zeros((5, 5))
        mujoco.mj_fullM(robot.model, data, full)
        assert_allclose(row, np.diag(full), rtol=1e-10)


def test_a_payload_is_a_point_mass_in_the_frame_of_its_link():
    robot = tree()
    link, pos, quat = robot.link_of("c")
    mass = '<body name="c" pos=".3 0 .4" euler="0 90 10"><geom size="1e-3" pos=".1 .2 -.3" mass="1.5"/>'
    heavier = TREE.format("").replace('<body name="c" pos=".3 0 .4" euler="0 90 10">', mass)
    other = robot_from(mujoco.MjModel.from_xml_string(heavier))
    z, dz, ddz = (np.random.default_rng(i).standard_normal((5, 5)) for i in range(3))
    extra = link_rows(robot, z, dz, ddz)[:, :, link] @ moved(point_mass(1.5, np.array([0.1, 0.2, -0.3])), pos, quat)
    assert_allclose(
        nominal_torque(other, z, dz, ddz) - nominal_torque(robot, z, dz, ddz), extra, rtol=1e-4, atol=1e-4
    )  # the sphere has a size


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_inertial_parameters_come_back_from_each_form(seed):
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((5, 3))
    phi = sum(point_mass(float(m), p) for m, p in zip(rng.uniform(0.1, 2, 5), points, strict=True))
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(phi)) > 0)
    assert_allclose(unpack_pseudo_inertia(pseudo_inertia(phi)), phi, atol=1e-12)
    mass, centre, quat, principal = to_body(phi)
    assert_allclose(from_body(mass, centre, quat, principal), phi, atol=1e-9)
    assert principal[1] + principal[2] >= principal[0]


FIXED = '<tendon><fixed name="t">{}</fixed></tendon><actuator><motor name="m" tendon="t"/></actuator>'
SPATIAL = FIXED.format('<site site="s"/><site site="u"/>').replace("fixed", "spatial")
WORLD = "<mujoco><worldbody>{}</worldbody></mujoco>"
BODY = '<body name="x"><{} name="j"/><geom size=".1"/></body>'
HINGES = '<body name="x"><joint name="k"/><geom size=".1"/></body>' + BODY.replace('"x"', '"cube"').format("freejoint")
# two levers on a hinge, whose tips a rod ties: joints b, c and d are in the loop, a carries it, e hangs on it
LOOP = """<mujoco><worldbody><body><joint name="a"/><geom size=".1"/>
<body><joint name="b"/><geom size=".1"/><body name="x"><joint name="c"/><geom size=".1"/>
<body><joint name="e"/><geom size=".1"/></body></body></body>
<body name="y"><joint name="d"/><geom size=".1"/></body></body></worldbody>
<equality><weld name="rod" body1="x" body2="y"/></equality></mujoco>"""


def sites(xml):
    """The tree with a site at the base and one on its body c."""
    return xml.replace("<worldbody>", '<worldbody><site name="s"/>').replace('<body name="c"', '<body name="c"', 1).replace(
        '<geom size=".05" pos=".1 0 0"/>', '<geom size=".05" pos=".1 0 0"/><site name="u"/>'
    )  # fmt: skip


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        (WORLD.format(BODY.format("freejoint")), "'j' lets body 'x' float.*remove the joint.*where the base stands still"),
        (WORLD.format(HINGES), "'j' lets body 'cube' float.*remove body 'cube' in a copy of the model; k can then be diagnosed"),
        (WORLD.format(BODY.format('joint type="ball"')), "'j' is a ball joint.*--joint chooses"),
        (LOOP, r"equality 'rod' \(weld\) closes a chain.*joints a, e can then be diagnosed, by --joint"),
        (TREE.format('<equality><connect body1="c" anchor="0 0 0"/></equality>'), "closes a chain.*of a log of all joints e can"),
        (TREE.format(FIXED.format('<joint joint="a" coef="1"/>')), "both move joint 'a'"),
        (TREE.format(FIXED.format('<joint joint="b" coef="1"/><joint joint="d" coef="1"/>')), "'m' moves b, d.*2 independent"),
        (sites(TREE.format(SPATIAL)), "'m' pulls the spatial tendon 't'"),
        (TREE.format(TIE.replace("-2 0", "-2 1")), "ties joint 'e' to another one is no fixed ratio"),
        (TREE.format(TIE.replace("</equality>", '<joint joint1="b" joint2="e"/></equality>')), "tie joint .* to itself"),
    ],
)  # fmt: skip
def test_what_is_outside_is_said_in_one_line(xml, said):
    with pytest.raises(InputError, match=said) as error:
        robot_from(mujoco.MjModel.from_xml_string(xml))
    assert "\n" not in str(error.value)


def test_forces_that_the_rows_do_not_have_are_refused():
    robot = robot_from(
        mujoco.MjModel.from_xml_string(
            '<mujoco><worldbody><body><joint name="a" damping="1 2"/><geom size=".1" pos=".1 0 0"/></body></worldbody></mujoco>'
        )
    )
    with pytest.raises(InputError, match="hold more than links"):
        check_rows(robot)
