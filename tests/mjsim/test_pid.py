"""``<pid>`` as a drive: its law against plain MuJoCo, its inputs, its slewed setpoint, and what is written of it."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from servo_logs import PENDULUM, command, model, record

from diagnose.data.servo import as_servo
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mujoco_run import run_literal
from mjsim.ode import simulate
from mjsim.plant.base import Start
from mjsim.plant.mujoco import MujocoPlant
from mjsim.servo import Servo, Target

DT = 0.01
START = np.array([[0.1], [0.0]])


def text(actuator: str, timestep: float = 5e-4) -> str:
    whole = model(PENDULUM, timestep=timestep)
    at, end = whole.index("<position"), whole.index("/>", whole.index("<position")) + 2
    return whole[:at] + actuator + whole[end:]


def pid(more: str = "", kp: float = 8.0, kv: float = 0.3) -> str:
    return f'<pid name="servo" joint="hinge" kp="{kp}" kv="{kv}" {more}/>'


def write(folder, actuator: str, timestep: float = 5e-4):
    path = folder / "m.xml"
    path.write_text(text(actuator, timestep), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("actuator", "servo", "idle"),
    [
        (pid(), Servo(8.0, 0.3), ("vel",)),
        (pid('input="pos" posrange="-.4 .3" forcerange="-2 2"'), Servo(8.0, 0.3, limit=2.0, low=-0.4, high=0.3), ()),
        (pid('input="pos vel" velrange="-1 1"'), Servo(8.0, 0.3), ("vel",)),
        (pid('input="vel" velrange="-1 1"', kp=0.0), Servo(0.0, 0.3, Target.VELOCITY, low=-1.0, high=1.0), ()),
        (pid('input="ff"', kp=0.0), Servo(0.0, 0.3, Target.VELOCITY, scale=1 / 0.3), ()),
        (pid('gear="3"'), Servo(8.0, 0.3), ("vel",)),
    ],
    ids=["pos vel", "pos", "ranges", "vel", "ff with damping", "gear"],
)
def test_its_law_is_that_of_plain_mujoco(tmp_path, actuator, servo, idle):
    path = write(tmp_path, actuator)
    axis = load_axis(path)
    assert dataclasses.astuple(axis.chain.servo) == pytest.approx(dataclasses.astuple(servo), abs=1e-12)
    assert axis.chain.idle == idle
    u = command(2.5, DT, 0)
    theirs = run_literal(path, u, DT, initial=START)
    assert np.std(simulate(axis, u, DT, initial=START).angle - theirs.angle) < 5e-5 * np.std(theirs.angle)
    plant = MujocoPlant.load(path)
    assert plant.channels.role == "command"
    np.testing.assert_allclose(plant.run(u[:, None], DT, start=Start(0.1))[:, 1], theirs.angle, atol=1e-12)


def test_a_force_as_its_only_input_is_a_torque(tmp_path):
    path = write(tmp_path, pid('input="ff" ffrange="-.5 .5" gear="2"', kp=0.0, kv=0.0))
    axis = load_axis(path)
    assert (axis.chain.servo, axis.chain.gain) == (None, 2.0)
    assert [e.values["limit_Nm"] for e in axis.effects if e.id == "actuator_saturation"] == [0.5]
    u = 2.0 * command(2.5, DT, 0)
    theirs = run_literal(path, u, DT, initial=START)
    assert np.std(simulate(axis, u, DT, initial=START).angle - theirs.angle) < 5e-5 * np.std(theirs.angle)
    wider = [e.with_values({"limit_Nm": 0.8}) if e.id == "actuator_saturation" else e for e in axis.effects]
    write_corrected(
        path, dataclasses.replace(axis, effects=(*wider, effect_class("torque_offset")(torque_Nm=0.1))), tmp_path / "c.xml"
    )
    after = mujoco.MjModel.from_xml_path(str(tmp_path / "c.xml"))
    data = mujoco.MjData(after)
    for u, force in ((0.3, 0.35), (3.0, 0.85)):
        data.ctrl[0] = u
        mujoco.mj_forward(after, data)
        assert float(data.actuator_force[0]) == pytest.approx(force)


def test_the_slewed_setpoint_is_a_velocity_limit(tmp_path):
    """MuJoCo moves the setpoint once a step: what it is ahead by is of first order in the step, and gone at none."""
    u, runs = command(5.0, DT, 0), []
    for timestep in (4e-4, 2e-4):
        path = write(tmp_path, pid('slewmax="1.2"'), timestep)
        runs.append(run_literal(path, u, DT, initial=START).angle)
    axis = load_axis(path)
    assert [e.values["limit_rad_s"] for e in axis.effects if e.id == "velocity_limit"] == [1.2]
    ours = simulate(axis, u, DT, initial=START).angle
    errors = [np.std(run - ours) / np.std(ours) for run in runs]
    assert errors[0] == pytest.approx(2.0 * errors[1], rel=0.1)
    assert np.std(2.0 * runs[1] - runs[0] - ours) < 1e-4 * np.std(ours)
    free = dataclasses.replace(axis, effects=tuple(e for e in axis.effects if e.id != "velocity_limit"))
    assert np.std(simulate(free, u, DT, initial=START).angle - ours) > 20 * errors[0] * np.std(ours), "the limit acts"


def test_a_setpoint_begins_at_the_first_command_and_a_delay_at_that_before(tmp_path):
    path = write(tmp_path, pid('slewmax="1.2" delay=".02" nsample="101"'), 2e-4)
    u = 0.4 + command(3.0, DT, 0)
    run = run_literal(path, u, DT, initial=START, before=float(u[0]))
    ours = simulate(load_axis(path), u, DT, initial=START, before=float(u[0]))
    assert np.std(run.angle - ours.angle) < 2e-3 * np.std(ours.angle)
    path = write(tmp_path, pid('slewmax="1.2"'), 2e-4)
    run = run_literal(path, u, DT, initial=START)  # without a delay nothing is before the first command
    assert np.std(run.angle - simulate(load_axis(path), u, DT, initial=START).angle) < 2e-3 * np.std(run.angle)


@pytest.mark.parametrize(
    ("actuator", "said"),
    [
        (pid('ki="3" imax=".2"'), "stops its integral at imax = 0.2"),
        (pid('input="pos ff"'), "inputs pos ff, of which a log holds one.*use input="),
        (pid('input="pos vel ff"'), "inputs pos vel ff"),
        (pid('input="vel"'), 'input="vel" whose kp = 8 holds the joint at 0.*write kp="0"'),
        (pid('input="ff"'), 'input="ff" whose kp = 8'),
        (pid(kp=0.0), 'kp = 0, which does nothing.*use input="vel"'),
    ],
)
def test_other_mixes_are_refused_in_one_line(tmp_path, actuator, said):
    with pytest.raises(InputError, match=said) as error:
        load_axis(write(tmp_path, actuator))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("more", ["", 'input="pos" posrange="-.4 .3"', 'slewmax="1.2"', 'dampratio="1" inheritrange=".5"'])
def test_new_numbers_are_written_in_its_place_and_its_inputs_stay(tmp_path, more):
    actuator = pid(more) if "dampratio" not in more else pid(more).replace('kv="0.3"', "")
    path = write(tmp_path, actuator)
    path.write_text(path.read_text().replace('type="hinge" axis', 'type="hinge" range="-2 2" axis'), encoding="utf-8")
    axis, out = load_axis(path), tmp_path / "c.xml"
    changed = axis.with_linear({"kp": 5.0, "kv": 0.2, "zero": 0.02, "Jm": 0.03})
    assert write_corrected(path, changed, out).lacks == ()
    assert load_axis(out) == changed
    before, after = (mujoco.MjModel.from_xml_path(str(p)) for p in (path, out))
    np.testing.assert_array_equal(before.actuator_ctrlspec, after.actuator_ctrlspec)
    np.testing.assert_array_equal(before.actuator_ctrlrange, after.actuator_ctrlrange)
    np.testing.assert_array_equal(before.actuator_dynprm[:, :2], after.actuator_dynprm[:, :2])
    np.testing.assert_allclose(after.actuator_biasprm[0, :3], [-0.1, -5.0, -0.2])
    write_corrected(out, axis, tmp_path / "back.xml")
    assert load_axis(tmp_path / "back.xml") == axis


@pytest.mark.parametrize("actuator", [pid(), pid('slewmax="3"'), '<position name="servo" joint="hinge" kp="8" kv=".3"/>'])
def test_a_velocity_limit_that_is_found_is_its_slewmax(tmp_path, actuator):
    path, out = write(tmp_path, actuator), tmp_path / "c.xml"
    axis = load_axis(path)
    others = [e for e in axis.effects if e.id != "velocity_limit"]
    found = dataclasses.replace(axis, effects=(*others, effect_class("velocity_limit")(limit_rad_s=0.8))).with_linear({"kp": 6.0})
    assert write_corrected(path, found, out).lacks == ()
    u = command(2.5, DT, 0)
    theirs, ours = run_literal(out, u, DT, initial=START).angle, simulate(found, u, DT, initial=START).angle
    assert np.std(theirs - ours) < 3e-3 * np.std(ours), "0.5 ms ahead of the ramp"
    assert load_model(out).mjmodel.actuator_dynprm[0, 1] == 0.8
    write_corrected(out, axis, tmp_path / "back.xml")
    assert load_axis(tmp_path / "back.xml") == axis


@pytest.mark.parametrize(("more", "native"), [('input="pos"', True), ("", False), ('input="pos" slewmax="3"', False)])
def test_a_lag_is_written_where_there_is_one_setpoint_and_no_slewmax(tmp_path, more, native):
    path, out = write(tmp_path, pid(more)), tmp_path / "c.xml"
    found = (load_axis(path) + effect_class("actuator_lag")(time_constant_s=0.02)).with_linear({"kp": 6.0})
    lacks = write_corrected(path, found, out).lacks
    assert bool(lacks) != native
    assert load_axis(out) == found
    if native:
        u = command(2.5, DT, 0)
        theirs = run_literal(out, u, DT, initial=START).angle
        assert np.std(theirs - simulate(found, u, DT, initial=START).angle) < 1e-3 * np.std(theirs)
    else:
        assert "no filter" in lacks[0]


def test_an_input_that_the_log_does_not_hold_is_said_to_be_zero(tmp_path):
    for more, said in (("", True), ('input="pos"', False)):
        axis = load_axis(write(tmp_path, pid(more)))
        log = record(text(pid(more)), seconds=5.0)
        *_, notes = as_servo(axis, [log], [])
        assert any("further input vel" in note and "taken as zero" in note for note in notes) == said
