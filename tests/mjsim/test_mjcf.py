"""MJCF -> axis: any single-axis chain is read, anything else is one line that says what is outside."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mjcf_chains import Spec, chain_xml

from mjsim.effects import BacklashLaw, effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model
from mjsim.models import shipped_model, shipped_models
from mjsim.quantity import Motion
from mjsim.system import assemble, state_matrix


@pytest.fixture(scope="module")
def nominal():
    return shipped_model("robot_axis1")


def edited(tmp_path: Path, source: Path, *pairs: tuple[str, str]) -> Path:
    text = source.read_text(encoding="utf-8")
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new)
    out = tmp_path / "edited.xml"
    out.write_text(text, encoding="utf-8")
    return out


def write(tmp_path: Path, text: str) -> Path:
    out = tmp_path / "model.xml"
    out.write_text(text, encoding="utf-8")
    return out


def test_the_nominal_axis_has_the_numbers_of_the_study(nominal):
    axis = load_axis(nominal)
    values = {p.name: p.value for p in axis.chain.linear_parameters()}
    assert values == {
        "Jm": 4.56e-4, "Jg": 9.92, "Ja": 1.72, "fm": 3.55e-2, "kg": 1.5e5, "ka": 4.46e4, "dg": -62.0, "da": 20.0,
    }  # fmt: skip
    assert axis.chain.couplings[0].ratio == pytest.approx(1 / 118, rel=1e-14)
    assert axis.effects == ()
    assert [b.joint for b in axis.chain.bodies] == ["motor", "gearbox", "arm"]
    assert [c.joint for c in axis.chain.couplings] == ["gearbox", "arm"]
    assert (axis.chain.actuator, axis.chain.velocity_sensor, axis.chain.angle_sensor) == (
        "motor_torque",
        "motor_velocity",
        "motor_angle",
    )


def test_the_nominal_poles_are_those_of_the_study(nominal):
    poles = np.linalg.eigvals(state_matrix(assemble(load_axis(nominal)).f))
    hz = sorted(abs(p) / 2 / np.pi for p in poles if p.imag > 1.0)
    assert hz == pytest.approx([25.1, 32.9], abs=0.1)
    assert min(p.real for p in poles) == pytest.approx(-28.7, abs=0.3)


def test_every_name_of_the_contract_is_in_the_model(nominal):
    model = mujoco.MjModel.from_xml_path(str(nominal))
    for joint in ("motor", "gearbox", "arm", "backlash"):
        assert model.joint(joint).name == joint
    assert model.actuator("motor_torque").name == "motor_torque"
    for sensor in ("motor_velocity", "motor_angle", "arm_angle"):
        assert model.sensor(sensor).name == sensor


def test_emps_is_one_mass_on_a_slide():
    chain = load_axis(shipped_model("emps")).chain
    assert (chain.bodies[0].inertia, chain.bodies[0].viscous, chain.motion, chain.couplings) == (95.0, 200.0, Motion.SLIDE, ())


def test_kuka_is_one_inertia_at_the_link_behind_its_gear():
    chain = load_axis(shipped_model("kuka_kr300_axis1")).chain
    assert (chain.bodies[0].inertia, chain.bodies[0].viscous, chain.gain) == (1609.0, 1939.52, 256.857)


def test_an_unknown_shipped_model_lists_the_choices():
    assert set(shipped_models()) >= {"robot_axis1", "emps", "kuka_kr300_axis1"}
    with pytest.raises(InputError, match="one of: arm3, arm6, emps"):
        shipped_model("robot_axis9")


positive = st.floats(1e-2, 1e2)


@st.composite
def specs(draw):
    n = draw(st.integers(1, 4))
    style = draw(st.sampled_from(["nested", "side"]))
    many = lambda size: tuple(draw(positive) for _ in range(size))  # noqa: E731
    return Spec(
        many(n), draw(positive), tuple(1e3 * k for k in many(n - 1)), tuple(d - 0.5 for d in many(n - 1)),
        draw(st.floats(0.005, 3.0)), draw(st.sampled_from(["hinge", "slide"])), style, draw(st.floats(0.1, 300.0)),
    )  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(s=specs())
def test_any_chain_of_one_to_four_bodies_is_read_back(tmp_path_factory, s):
    chain = load_axis(write(tmp_path_factory.mktemp("chain"), chain_xml(s))).chain
    assert chain.motion.value == s.motion
    assert [b.inertia for b in chain.bodies] == pytest.approx(s.inertia, rel=1e-9)
    assert [c.stiffness for c in chain.couplings] == pytest.approx(s.stiffness, rel=1e-9)
    assert [c.damping for c in chain.couplings] == pytest.approx(s.damping, rel=1e-9)
    assert [c.ratio for c in chain.couplings] == pytest.approx([s.ratio, 1.0, 1.0][: len(s.stiffness)], rel=1e-9)
    assert [b.viscous for b in chain.bodies] == pytest.approx([s.viscous, 0.0, 0.0, 0.0][: len(s.inertia)], rel=1e-9)
    assert chain.gain == pytest.approx(s.gain, rel=1e-9)
    assert (chain.velocity_sensor, chain.angle_sensor, chain.actuator) == ("speed", "place", "drive")
    assert chain.bodies[0].joint == "j0"
    assert len({p.name for p in chain.linear_parameters()}) == len(chain.linear_parameters())


# ---- native effects of a user's own model ---------------------------------------------------------------------------


def test_frictionloss_is_read_as_coulomb_friction(tmp_path, nominal):
    axis = load_axis(edited(tmp_path, nominal, ('frictionloss="0"', 'frictionloss="0.1"')))
    assert axis.effects == (effect_class("coulomb_friction")(place="motor", torque_Nm=0.1),)


def test_an_open_slack_joint_is_read_as_backlash_with_its_own_law(tmp_path, nominal):
    pairs = (('range="-1e-6 1e-6"', 'range="-2.5e-4 2.5e-4"'), ('joint1="backlash"', 'active="false" joint1="backlash"'))
    axis = load_axis(edited(tmp_path, nominal, *pairs))
    assert axis.effects == (effect_class("backlash")(place="gearbox", gap_rad=5e-4),)
    assert axis.backlash_law is BacklashLaw.UNGATED


def test_a_dead_band_is_read_as_backlash(tmp_path):
    s = Spec((1.0, 2.0), 0.1, (1e3,), (1.0,), 0.5, "hinge", "side", 1.0)
    text = chain_xml(s).replace('<fixed name="t0"', '<fixed name="t0" springlength="-0.01 0.01"')
    axis = load_axis(write(tmp_path, text))
    assert axis.effects == (effect_class("backlash")(place="gearbox", gap_rad=0.01),)


def test_actuator_attributes_are_read_as_effects(tmp_path, nominal):
    new = (
        '<general name="motor_torque" joint="motor" ctrllimited="true" ctrlrange="-2 2" delay="0.002" nsample="5"'
        ' dyntype="filter" dynprm="0.01" biastype="affine" biasprm="0.05 0 0"/>'
    )
    axis = load_axis(edited(tmp_path, nominal, ('<motor name="motor_torque" joint="motor" gear="1"/>', new)))
    assert {e.key: tuple(e.values.values()) for e in axis.effects} == {
        "actuator_saturation@actuator": (2.0,),
        "time_delay@actuator": (0.002,),
        "actuator_lag@actuator": (0.01,),
        "torque_offset@motor": (0.05,),
    }


PENDULUM = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="j" axis="0 1 0"/>
<inertial pos="{x} 0 {z}" mass="2" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor name="m" joint="j"/></actuator></mujoco>"""


@pytest.mark.parametrize(("x", "z", "phase"), [(0.0, -0.5, 0.0), (0.5, 0.0, -np.pi / 2), (0.0, 0.5, np.pi)])
def test_gravity_on_a_hinge_is_read_as_a_gravity_load(tmp_path, x, z, phase):
    axis = load_axis(write(tmp_path, PENDULUM.format(x=x, z=z)))
    (load,) = axis.effects
    assert load.key == "gravity_load@arm"
    assert load.values["torque_Nm"] == pytest.approx(2 * 9.81 * 0.5)
    assert np.exp(1j * load.values["phase_rad"]) == pytest.approx(np.exp(1j * phase), abs=1e-9)
    assert axis.chain.bodies[0].inertia == pytest.approx(1 + 2 * 0.25)
    # against MuJoCo's own force, away from the sampled angles
    model = load_model(tmp_path / "model.xml").mjmodel
    data = mujoco.MjData(model)
    data.qpos[0] = 0.777
    mujoco.mj_forward(model, data)
    assert -data.qfrc_bias[0] == pytest.approx(-load.values["torque_Nm"] * np.sin(0.777 + load.values["phase_rad"]))


def test_gravity_along_a_slide_is_a_torque_offset(tmp_path):
    text = PENDULUM.format(x=0, z=0).replace('axis="0 1 0"', 'type="slide" axis="0 0 1"')
    (offset,) = load_axis(write(tmp_path, text)).effects
    assert (offset.key, offset.values["torque_Nm"]) == ("torque_offset@motor", pytest.approx(-2 * 9.81))


# ---- outside the class, and bad input -------------------------------------------------------------------------------

BODY = '<body{name}>{joint}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{inside}</body>'


def bodies(*joints: str, **more: str) -> str:
    inner = "".join(f'<body>{j}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>' for j in joints)
    rest = "".join(f"<{k}>{v}</{k}>" for k, v in more.items())
    return f'<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody>{inner}</worldbody>{rest}</mujoco>'


ONE = '<joint name="a" axis="0 0 1"/>'
TWO = '<joint name="b" axis="0 0 1"/>'
THREE = '<joint name="c" axis="0 0 1"/>'
MOTOR = '<motor name="m" joint="a"/>'


def spring(name: str, one: str, two: str, extra: str = "") -> str:
    return f'<fixed name="{name}" stiffness="10" {extra}><joint joint="{one}" coef="1"/><joint joint="{two}" coef="-1"/></fixed>'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (bodies(ONE, TWO, actuator=""), "0 actuators and none bound .there are: none., and 2 joints move"),
        (bodies(ONE, TWO, actuator=MOTOR + '<motor name="n" joint="b"/>'), "2 actuators and none bound .there are: 'm', 'n'."),
        (bodies("<freejoint/>", ONE, actuator=MOTOR), "is a free joint"),
        (bodies('<joint type="ball"/>', ONE, actuator=MOTOR), "is a ball joint"),
        (bodies(ONE, TWO, actuator=MOTOR), "hang on no spring or damper"),
        (
            bodies(ONE, TWO, THREE, actuator=MOTOR, tendon=spring("s", "a", "b") + spring("t", "a", "c")),
            "the chain branches",
        ),
        (bodies('<joint name="a" stiffness="3 0 1"/>', actuator=MOTOR), "holds 'a' to the ground"),
        (bodies(ONE, TWO, actuator=MOTOR, tendon=spring("s", "a", "b", 'frictionloss="1"')), "acts between two bodies"),
        (
            bodies(ONE, TWO, actuator=MOTOR, equality='<joint joint1="a" joint2="b" polycoef="0 2 1 0 0"/>'),
            "polycoef of degree above one",
        ),
        (
            bodies('<joint name="a" axis="0 0 1"/><joint name="x" axis="0 1 0"/>', actuator=MOTOR),
            "turns and moves about more than one axis",
        ),
        (bodies(ONE, TWO, actuator=MOTOR, tendon=spring("s", "a", "b", 'springlength="0.1"')), "loaded in the zero position"),
        (bodies(ONE, actuator='<motor name="m" joint="a" ctrllimited="true" ctrlrange="0 1"/>'), "symmetric about zero"),
        (
            bodies(ONE, actuator=MOTOR + '<dcmotor joint="a" input="none" resistance="1" motorconst="0 0" cogging="1 8.5 0"/>'),
            "acts by itself",
        ),
    ],
)
def test_what_is_outside_is_said_in_one_line(tmp_path, text, said):
    with pytest.raises(InputError, match=said) as caught:
        load_axis(write(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "model.xml") in str(caught.value)


def test_touching_bodies_are_outside(tmp_path):
    text = (
        '<mujoco><option gravity="0 0 0"/><worldbody><geom name="wall" type="box" size="1 1 1" pos="0 0 1.05"/>'
        '<body><joint name="a" axis="0 0 1"/><geom name="arm" type="box" size=".1 .1 .1"/></body></worldbody>'
        f"<actuator>{MOTOR}</actuator></mujoco>"
    )
    with pytest.raises(InputError, match="geoms wall and arm touch"):
        load_axis(write(tmp_path, text))


def test_a_branch_of_inertia_that_depends_on_the_pose_is_outside(tmp_path):
    text = (
        '<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="a" axis="0 0 1"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body pos="1 0 0"><joint name="b" axis="0 0 1" stiffness="10"/>'
        '<inertial pos="1 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody>'
        f"<actuator>{MOTOR}</actuator></mujoco>"
    )
    with pytest.raises(InputError, match="more than one axis"):
        load_axis(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mujoco><worldbody>", "MuJoCo does not load it"),
        ("", "MuJoCo does not load it"),
        ('<mujoco><worldbody><body><joint name="a"/></body></worldbody></mujoco>', "MuJoCo does not load it"),
    ],
)
def test_mjcf_that_does_not_load_is_one_line_and_leaves_no_log(tmp_path, monkeypatch, capfd, text, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=said):
        load_axis(write(tmp_path, text))
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert capfd.readouterr() == ("", "")


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_axis(tmp_path / "none.xml")


def test_a_binding_picks_the_actuator_and_the_sensors(tmp_path):
    text = bodies(ONE, actuator=MOTOR + '<motor name="n" joint="a" gear="5"/>', sensor='<jointvel name="v" joint="a"/>')
    path = write(tmp_path, text)
    path.with_suffix(".toml").write_text('[model]\nactuator = "n"\nvelocity_sensor = "v"\n')
    chain = load_axis(path).chain
    assert (chain.gain, chain.actuator, chain.velocity_sensor) == (5.0, "n", "v")
    path.with_suffix(".toml").write_text('[model]\nactuator = "q"\n')
    with pytest.raises(InputError, match="no actuator 'q'; expected one of: 'm', 'n'"):
        load_axis(path)
    path.with_suffix(".toml").write_text('[model]\nactuators = "q"\n')
    with pytest.raises(InputError, match="key 'actuators' is not known"):
        load_axis(path)
