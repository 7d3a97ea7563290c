"""``<dcmotor>`` as a drive: by voltage and by its controller, against plain MuJoCo; what is refused and what is written."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from servo_logs import PENDULUM, command, model

from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, write_corrected
from mjsim.mjcf.write import check_writable
from mjsim.mujoco_run import run_literal
from mjsim.ode import simulate
from mjsim.plant.base import Start
from mjsim.plant.mujoco import MujocoPlant
from mjsim.servo import Target

DT = 0.01
START = np.array([[0.1], [0.0]])
K, R = 0.5, 0.3
LINE, VOLTS = ("torque_speed_limit",), (0.0, K * K / R, K / R)


def text(actuator: str, timestep: float = 1e-4) -> str:
    whole = model(PENDULUM, timestep=timestep)
    at, end = whole.index("<position"), whole.index("/>", whole.index("<position")) + 2
    return whole[:at] + actuator + whole[end:]


def motor(more: str = "") -> str:
    return f'<dcmotor name="servo" joint="hinge" motorconst="{K}" resistance="{R}" {more}/>'


def write(folder, more: str, timestep: float = 1e-4, name: str = "m.xml"):
    path = folder / name
    path.write_text(text(more if more.startswith("<") else motor(more), timestep), encoding="utf-8")
    return path


def moved(path, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints (N,) and the angle (N,) by which plain MuJoCo answers; the plant of the file runs as MuJoCo."""
    u = scale * command(1.2, DT, 0)
    theirs = run_literal(path, u, DT, initial=START).angle
    plant = MujocoPlant.load(path)
    np.testing.assert_allclose(plant.run(u[:40, None], DT, start=Start(0.1))[:, 1], theirs[:40], atol=1e-12)
    return u, theirs


def off(axis, motion) -> float:
    """rms of the angle by which the equations and the motion of plain MuJoCo differ, over its spread."""
    u, theirs = motion
    return float(np.std(simulate(axis, u, DT, initial=START).angle - theirs) / np.std(theirs))


def apart(path, axis, scale: float = 1.0) -> float:
    return off(axis, moved(path, scale))


@pytest.mark.parametrize(
    ("more", "target", "numbers", "effects", "scale"),
    [
        ('ctrlrange="-.5 .4"', Target.VELOCITY, VOLTS, (), 1.0),
        ('saturation=".6 0 0" gear="-2"', Target.VELOCITY, VOLTS, (), 2.0),
        pytest.param('cogging=".1 6 .4"', Target.VELOCITY, VOLTS, ("torque_ripple",), 1.0, marks=pytest.mark.slow),
        ('gear="-2" cogging=".1 3 .4" saturation=".6"', Target.VELOCITY, VOLTS, ("torque_ripple",), 1.0),
        ('lugre="50 .1 .1 .15 .05"', Target.VELOCITY, VOLTS, ("stribeck_friction_with_bristles",), 1.0),
        ('input="pos" controller="8 0 .3 0 0 0"', Target.POSITION, (8.0, 0.3, 8.0), (), 1.0),
        ('input="pos vel" controller="8 0 .3 0 0 .9" saturation="1.2"', Target.POSITION, (8.0, 0.3, 8.0), LINE, 1.0),
        ('gear="3" input="pos" controller="1 0 .1 0 0 2.2"', Target.POSITION, (1.0, 0.1, 1.0), LINE, 3.0),
        ('input="pos" controller="8 9 .3 0 0 0" gear="2"', Target.POSITION, (8.0, 0.3, 8.0), ("integral_action",), 2.0),
        ('input="vel" controller="0 0 .9 0 0 .9"', Target.VELOCITY, (0.0, 0.9, 0.9), LINE, 6.0),
        ('input="ff" controller="0 0 .2 0 0 0"', Target.VELOCITY, (0.0, 0.2, 1.0), (), 1.0),
        ('gear="2" input="pos" controller="2 0 .1 0 0 0" armature=".02"', Target.POSITION, (2.0, 0.1, 2.0), (), 2.0),
    ],
)  # fmt: skip
def test_its_law_is_that_of_plain_mujoco(tmp_path, more, target, numbers, effects, scale):
    path = write(tmp_path, more)
    axis = load_axis(path)
    servo = axis.chain.servo
    assert servo.target is target
    assert (servo.kp, servo.kv, servo.gain) == pytest.approx(numbers, abs=1e-12)
    assert tuple(e.id for e in axis.effects if e.id != "gravity_load") == effects
    motion = moved(path, scale)
    assert off(axis, motion) < 5e-5
    for effect in axis.effects:
        if effect.id != "gravity_load":
            assert off(axis.without(effect.key), motion) > 1e-3, f"{effect.id} acts"


def test_armature_and_damping_of_an_actuator_are_of_its_joint_by_the_square_of_its_gear(tmp_path):
    bare, more = (load_axis(write(tmp_path, f'gear="2" {x}')).chain.bodies[0] for x in ("", 'armature=".02" damping=".03"'))
    assert more.inertia - bare.inertia == pytest.approx(0.08)
    assert more.viscous - bare.viscous == pytest.approx(0.12)
    path = write(tmp_path, 'gear="2" armature=".02" damping=".03"')
    changed = load_axis(path).with_linear({"Jm": 0.2, "fm": 0.4})
    write_corrected(path, changed, tmp_path / "c.xml")
    assert load_axis(tmp_path / "c.xml").chain.bodies[0].inertia == pytest.approx(0.2)
    assert apart(tmp_path / "c.xml", changed) < 5e-5


def test_a_slewed_setpoint_beside_a_bristle_is_ahead_by_half_a_step(tmp_path):
    errors = []
    for timestep in (2e-4, 1e-4):
        path = write(tmp_path, 'input="pos" controller="8 0 .3 1.2 0 0" lugre="50 0 .1 .1 .05"', timestep)
        axis = load_axis(path)
        assert {"velocity_limit", "presliding_friction"} <= {e.id for e in axis.effects}
        errors.append(apart(path, axis))
    assert errors[0] == pytest.approx(2.0 * errors[1], rel=0.1)
    assert errors[1] < 1e-3


def test_a_torque_is_its_only_input(tmp_path):
    path = write(tmp_path, 'input="ff" ctrlrange="-.5 .5" gear="2"')
    axis = load_axis(path)
    assert (axis.chain.servo, axis.chain.gain) == (None, 2.0)
    assert apart(path, axis, 2.0) < 5e-5
    more = axis + effect_class("torque_offset")(torque_Nm=0.1)
    write_corrected(path, more, tmp_path / "c.xml")
    assert apart(tmp_path / "c.xml", more) < 5e-5


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ('inductance=".01 0"', "inductance.*0.0333.*leave inductance"),
        ('inductance=".01 0" saturation="0 0 50"', "current_rate.*<motor>"),
        ('thermal="1 2 0 .004 25 25"', "changes with its temperature.*leave thermal out"),
        ('input="pos" controller="8 2 .3 0 .5 0"', "<dcmotor> that stops its integral at imax = 0.5"),
        ('input="pos ff" controller="8 0 .3 0 0 0"', "<dcmotor> with the inputs pos ff"),
        ('input="pos voltage" controller="8 0 .3 0 0 0"', "<dcmotor> with the inputs pos voltage"),
        ('input="vel" controller="8 0 .3 0 0 0"', 'input="vel" whose kp = 8'),
        ('input="vel" controller="0 0 .3 2 0 0"', 'input="vel" with slewmax'),
        ('input="vel"', "no gain on it"),
        ('input="ff" controller="0 0 0 0 0 3"', "by its torque with a Vmax"),
        ('cogging=".1 6 0" gear=".55"', "cogging or a bristle.*leave cogging and lugre out"),
    ],
)  # fmt: skip
def test_what_no_law_stands_for_is_refused_in_one_line(tmp_path, more, said):
    with pytest.raises(InputError, match=said) as error:
        load_axis(write(tmp_path, more))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("more", "numbers"),
    [
        ("", {"gain": 2.0, "kv": 0.9, "Jm": 0.03}),
        ('saturation=".6 0 0"', {"gain": 2.0, "kv": 0.9, "limit": 0.4}),
        ('nominal="12 4 20" cogging=".1 6 .4"', {"gain": 0.4, "kv": 0.3}),
        pytest.param('input="pos" controller="8 0 .3 0 0 0"', {"kp": 6.0, "kv": 0.2}, marks=pytest.mark.slow),
        ('input="pos vel" controller="8 0 .3 2 0 .9" saturation="1.2"', {"kp": 6.0, "kv": 0.2, "limit": 1.0}),
        ('input="vel" controller="0 0 .9 0 0 .9"', {"kv": 0.7}),
    ],
)  # fmt: skip
def test_new_numbers_are_its_own(tmp_path, more, numbers):
    actuator = motor(more) if "nominal" not in more else f'<dcmotor name="servo" joint="hinge" {more}/>'
    path, out = write(tmp_path, actuator), tmp_path / "c.xml"
    axis = load_axis(path)
    changed = axis.with_linear(numbers)
    assert write_corrected(path, changed, out).lacks == ()
    assert '<dcmotor name="servo"' in out.read_text(encoding="utf-8")
    again = load_axis(out)
    assert dataclasses.astuple(again.chain.servo) == pytest.approx(dataclasses.astuple(changed.chain.servo))
    motion = moved(out)
    assert off(changed, motion) < 1e-3
    assert off(axis, motion) > 2e-3
    write_corrected(out, axis, tmp_path / "back.xml")
    assert load_axis(tmp_path / "back.xml") == axis


def test_what_is_found_of_its_laws_is_written_in_its_place(tmp_path):
    path, out = write(tmp_path, 'gear="-2" input="pos" controller="2 0 .1 0 0 0" cogging=".05 3 .4"'), tmp_path / "c.xml"
    axis = load_axis(path)
    ripple = next(e for e in axis.effects if e.id == "torque_ripple")
    assert (ripple.values["amplitude_Nm"], ripple.values["cycles_per_rev"]) == pytest.approx((0.1, 6.0))
    others = [e for e in axis.effects if e.id != "torque_ripple"]
    found = dataclasses.replace(
        axis,
        effects=(
            *others, ripple.with_values({"amplitude_Nm": 0.25, "phase_rad": 0.9}),
            effect_class("torque_speed_limit")(stall_torque_Nm=0.9, no_load_speed_rad_s=5.0),
            effect_class("velocity_limit")(limit_rad_s=3.0),
        ),
    )  # fmt: skip
    assert write_corrected(path, found, out).lacks == ()
    motion = moved(out, -2.0)
    assert off(found, motion) < 1e-3
    for effect in found.effects[-3:]:
        assert off(found.without(effect.key), motion) > 3e-3
    data = mujoco.MjModel.from_xml_path(str(out))
    assert int(data.actuator_gaintype[0]) == mujoco.mjtGain.mjGAIN_DCMOTOR
    assert data.nactuator == 1
    write_corrected(out, axis, tmp_path / "back.xml")
    assert load_axis(tmp_path / "back.xml") == axis


@pytest.mark.parametrize("name", ["torque_offset", "actuator_lag"])
@pytest.mark.parametrize(("more", "native"), [("", True), ('saturation=".8" gear="2"', True), ('cogging=".1 6 .4"', False)])
def test_a_torque_or_a_lag_beside_it_is_a_general(tmp_path, name, more, native):
    path, out = write(tmp_path, more), tmp_path / "c.xml"
    values = {"torque_Nm": 0.2} if name == "torque_offset" else {"time_constant_s": 0.03}
    found = (load_axis(path) + effect_class(name)(**values)).with_linear({"gain": 1.2, "kv": 0.6})
    lacks = write_corrected(path, found, out).lacks
    assert bool(lacks) != native
    if native:
        motion = moved(out, 2.0)
        assert off(found, motion) < 1e-3
        assert off(found.without(found.effects[-1].key), motion) > 5e-3
    else:
        assert "no constant torque and no filter" in lacks[0]


@pytest.mark.parametrize(
    "more",
    ["", 'cogging=".1 6 .4" lugre="50 .1 .1 .15 .05"', 'input="pos vel" controller="8 0 .3 2 0 .9" saturation="1.2"',
     'input="ff"', 'gear="2" armature=".02" damping=".03"'],
)  # fmt: skip
def test_every_number_can_be_written_back(tmp_path, more):
    check_writable(write(tmp_path, more))
