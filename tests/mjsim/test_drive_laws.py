"""Laws of actuators: a constant bias and a <dcmotor> are part of the chain; a plugin and a varying gain are refused in a line."""

from __future__ import annotations

import mujoco
import pytest

from mjsim.effects import registered
from mjsim.effects.registry import named_instead
from mjsim.errors import InputError
from mjsim.mjcf import load_axis
from mjsim.servo import Target

JOINT = """<mujoco>{extension}<compiler angle="radian"/><worldbody><body name="b">
<joint name="j" axis="0 1 0" damping="{damping}"/>
<inertial pos="0 0 0" mass="1" diaginertia=".02 .02 .02"/></body></worldbody><actuator>{actuator}</actuator></mujoco>"""
PID = """<plugin name="a" joint="j" plugin="mujoco.pid" actdim="1"><config key="kp" value="20"/>
<config key="ki" value="5"/></plugin>"""
DCMOTOR = '<dcmotor name="a" joint="j" gear="-3" motorconst=".5" resistance="2"/>'


def text(actuator: str, damping: float = 0.05, extension: str = "") -> str:
    return JOINT.format(actuator=actuator, damping=damping, extension=extension)


def write(folder, actuator: str, **more):
    (folder / "m.xml").write_text(text(actuator, **more), encoding="utf-8")
    return folder / "m.xml"


@pytest.mark.parametrize(
    ("actuator", "target"),
    [
        ('<intvelocity name="a" joint="j" kp="20" kv=".4" actrange="-3 3"/>', Target.INTEGRATED),
        ('<general name="a" joint="j" gainprm="20" biastype="affine" biasprm="0 -20 -.4"/>', Target.POSITION),
    ],
)
def test_a_servo_is_part_of_the_chain(tmp_path, actuator, target):
    servo = load_axis(write(tmp_path, actuator)).chain.servo
    assert (servo.kp, servo.kv, servo.target) == (20.0, 0.4, target)


def test_a_constant_bias_is_a_torque_offset(tmp_path):
    axis = load_axis(write(tmp_path, '<general name="a" joint="j" gainprm="2" biastype="affine" biasprm=".3 0 0"/>'))
    assert axis.chain.servo is None
    assert axis.chain.gain == 2.0
    (offset,) = axis.effects
    assert offset.id == "torque_offset"


@pytest.mark.parametrize(
    ("actuator", "said"),
    [
        (PID, "from a plugin.*use <position kp=.* kv=.*>"),
        (DCMOTOR.replace("/>", ' inductance=".01 0"/>'), "is a <dcmotor> with inductance.*use <motor>"),
        ('<general name="a" joint="j" gaintype="affine" gainprm="2 0 -.1"/>', "gain that depends on the motion.*use <motor>"),
        ('<damper name="a" joint="j" kv=".5" ctrlrange="0 1"/>', "gain that depends on the motion"),
    ],
)
def test_another_law_is_refused_with_what_works(tmp_path, actuator, said):
    extension = '<extension><plugin plugin="mujoco.pid"/></extension>' if actuator == PID else ""
    with pytest.raises(InputError, match=said) as error:
        load_axis(write(tmp_path, actuator, extension=extension))
    assert "simgap render still works" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_dcmotor_is_the_motor_with_a_back_emf_that_moves_alike(tmp_path):
    chain = load_axis(write(tmp_path, DCMOTOR)).chain
    assert chain.servo is not None
    assert chain.servo.back_emf
    gear, damping = chain.gain * chain.servo.gain, chain.gain**2 * chain.servo.kv
    ends = []
    for model in (text(DCMOTOR), text(f'<motor name="a" joint="j" gear="{gear}"/>', 0.05 + damping)):
        m = mujoco.MjModel.from_xml_string(model)
        m.opt.timestep, m.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
        d = mujoco.MjData(m)
        d.ctrl[0] = 1.0
        mujoco.mj_step(m, d, 2000)
        ends.append(float(d.qvel[0]))
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)


def test_a_limit_of_the_current_is_named_by_its_identifier():
    assert "use 'actuator_saturation'" in named_instead("current_limit", registered())
    assert "actuator_saturation" not in named_instead("current_limit", ["backlash"])
    assert named_instead("backlas", registered()) == "did you mean 'backlash'?"
