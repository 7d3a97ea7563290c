"""Drives of MuJoCo 4 in robots: a ``<pid>`` with several controls runs as the ``<position>`` that it is, and is written back."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from diagnose.robot.servos.motion import joint_problem, prepare
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, simulate
from mjsim.errors import InputError
from mjsim.robot.carried import effect_of_slots, effect_slots
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.drives import joint_drives
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.rows import check_rows
from mjsim.robot.write import carried_effects, write_robot
from mjsim.robot.write_servo import NewServo, can_be_pid

NOMINAL = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))
DT = 0.01
ELECTRIC = 'motorconst="2" resistance="1.5"'


def pids(folder, more: str = "", name: str = "pid.xml"):
    """The robot's file with a ``<pid>`` in place of each ``<position>``, and a passive actuator ahead of them."""
    text = servo_mjcf(NOMINAL)
    assert text.count("<position") == 3
    text = text.replace("<position", f"<pid {more}")
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def log():
    t = np.arange(0, 4.0, DT)
    command = command_for(NOMINAL, np.random.default_rng(4), t)
    return RobotRecording(t, ("joint1", "joint2", "joint3"), DT, simulate(NOMINAL, command, DT), command=command)


def test_pids_with_two_controls_run_as_the_positions_that_they_are(tmp_path, log):
    (tmp_path / "arm.xml").write_text(servo_mjcf(NOMINAL), encoding="utf-8")
    as_position, as_pid = load_robot(tmp_path / "arm.xml"), load_robot(pids(tmp_path))
    assert (as_pid.model.nu, as_pid.model.nactuator) == (6, 3)
    for a, b in zip(joint_drives(as_position), joint_drives(as_pid), strict=True):
        assert a.servo == b.servo
        np.testing.assert_array_equal(a.slots, b.slots)
        assert (a.idle, b.idle) == ((), ("vel",))
    np.testing.assert_allclose(closed_loop(as_pid, log).z, closed_loop(as_position, log).z, atol=1e-12)
    carried = {"effect": "servo_deadband", "joint": "joint2", "parameters": {"half_width_rad": 0.05}}
    np.testing.assert_allclose(closed_loop(as_pid, log, [carried]).z, closed_loop(as_position, log, [carried]).z, atol=1e-12)


def test_a_slewed_setpoint_is_a_slot_and_stands_in_the_file(tmp_path, log):
    robot = load_robot(pids(tmp_path, 'slewmax="0.4"'))
    assert [d.slots[SLOT["slew"]] for d in joint_drives(robot)] == [0.4] * 3
    slewed = simulate(NOMINAL.with_servo(0, slew=0.4).with_servo(1, slew=0.4).with_servo(2, slew=0.4), log.command, DT)
    free = closed_loop(load_robot(pids(tmp_path, name="free.xml")), log).z
    error = closed_loop(robot, log).z - slewed
    assert np.std(error) < 0.05 * np.std(free - slewed)


@pytest.mark.parametrize("more", [None, "", 'input="pos"', 'slewmax="3"'])
def test_gains_and_a_velocity_limit_are_written_at_the_actuator(tmp_path, log, more):
    path = tmp_path / "arm.xml"
    if more is None:
        path.write_text(servo_mjcf(NOMINAL), encoding="utf-8")
    else:
        path = pids(tmp_path, more)
    robot, out = load_robot(path), tmp_path / "corrected.xml"
    d = joint_drives(robot)[1]
    assert can_be_pid(robot.model, d.actuator, d.servo)
    new = dataclasses.replace(d.servo, kp=70.0, kv=5.0, zero=0.01)
    write_robot(path, robot, out, robot.nominal - robot.fixed, {}, [], [NewServo(d.actuator, d.servo, new, 0.5)])
    again = load_robot(out)
    found = joint_drives(again)[1]
    assert found.servo == new
    assert found.slots[SLOT["slew"]] == 0.5
    assert found.idle == d.idle
    assert joint_drives(again)[0].servo == joint_drives(robot)[0].servo
    changed = NOMINAL.with_servo(1, kp=70.0, kv=5.0, slew=0.5)
    shifted = np.array(log.command)
    shifted[:, 1] -= 0.01
    truth = simulate(changed, shifted, DT)[:, 1]
    error = closed_loop(again, log).z[:, 1] - truth
    assert np.std(error[100:]) < 0.05 * np.std((closed_loop(robot, log).z[:, 1] - truth)[100:])


def motors(folder, more: str, name: str = "dc.xml"):
    """The robot's file with a ``<dcmotor>`` and its controller in place of each ``<position>``."""
    text = servo_mjcf(NOMINAL)
    for i, s in enumerate(NOMINAL.servos):
        old = f'<position name="servo{i + 1}" joint="joint{i + 1}" kp="{s.kp:.9g}" kv="{s.kv:.9g}"/>'
        assert old in text
        new = f'<dcmotor name="servo{i + 1}" joint="joint{i + 1}" {"" if "nominal" in more else ELECTRIC} '
        text = text.replace(old, new + more.format(kp=s.kp, kv=s.kv) + "/>")
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("more", "change"),
    [
        ('input="pos vel" controller="{kp} 0 {kv} 0 0 0"', {}),
        ('input="pos" controller="{kp} 0 {kv} 0.3 0 0"', {"slew": 0.3}),
        ('nominal="4 20 2" input="pos" controller="{kp} 0 {kv} 0 0 4"', {"stall": 20.0, "no_load": 2.0}),
    ],
)
def test_a_controller_of_a_motor_acts_as_the_sealed_plant_has_it(tmp_path, log, more, change):
    robot = load_robot(motors(tmp_path, more))
    whole = NOMINAL
    for i in range(3):
        whole = whole.with_servo(i, **change)
    truth = simulate(whole, log.command, DT)
    r = dataclasses.replace(log, angle=truth)
    run = closed_loop(robot, r).z
    free = simulate(NOMINAL, log.command, DT)
    if change:
        assert np.std(run - truth) < 0.05 * np.std(free - truth)
    else:
        assert np.std(run - truth) < 2e-3
    m = prepare(robot, r, False)
    for name in robot.joints:
        p = joint_problem(robot, [m], name, True)
        assert np.std(p.error(p.nominal)[30:]) < max(0.06 * np.std(free - truth), 1e-3)


def test_a_motor_by_its_voltage_runs_as_the_general_that_it_is(tmp_path, log):
    path = motors(tmp_path, 'saturation="40"')
    robot, out = load_robot(path), tmp_path / "corrected.xml"
    d = joint_drives(robot)[2]
    assert d.servo.back_emf
    assert (d.servo.gain, d.servo.kv, d.servo.limit) == pytest.approx((2 / 1.5, 4 / 1.5, 40.0))
    assert d.velocity
    new = dataclasses.replace(d.servo, kv=2.0)
    write_robot(path, robot, out, robot.nominal - robot.fixed, {}, [], [NewServo(d.actuator, d.servo, new)])
    again = load_robot(out)
    found = joint_drives(again)[2].servo
    assert (found.gain, found.kv, found.limit) == pytest.approx((new.gain, 2.0, 40.0))
    volts = dataclasses.replace(log, command=3.0 * log.command)
    general = path.read_text(encoding="utf-8")
    at = general.index('<dcmotor name="servo3"')
    end = general.index("/>", at) + 2
    spelled = (
        '<general name="servo3" joint="joint3" forcelimited="true" forcerange="-40 40" '
        f'gainprm="{new.gain!r}" biastype="affine" biasprm="0 0 -2.0"/>'
    )
    (tmp_path / "general.xml").write_text(general[:at] + spelled + general[end:], encoding="utf-8")
    np.testing.assert_allclose(closed_loop(again, volts).z, closed_loop(load_robot(tmp_path / "general.xml"), volts).z, atol=1e-9)


def test_armature_and_damping_of_an_actuator_are_of_its_joint(tmp_path, log):
    with_own, at_joint = tmp_path / "own.xml", tmp_path / "joint.xml"
    text = servo_mjcf(NOMINAL)
    (tmp_path / "arm.xml").write_text(text, encoding="utf-8")
    bare = load_robot(tmp_path / "arm.xml")
    assert 'joint="joint2" kp="90"' in text
    with_own.write_text(
        text.replace('joint="joint2" kp="90"', 'joint="joint2" gear="2" armature=".05" damping=".3" kp="22.5"').replace(
            'gear="2" armature=".05" damping=".3" kp="22.5" kv="8"', 'gear="2" armature=".05" damping=".3" kp="22.5" kv="2"'
        ),
        encoding="utf-8",
    )
    robot = load_robot(with_own)
    check_rows(robot)
    at = robot.leading(1)
    assert robot.armature[at] - bare.armature[at] == pytest.approx(0.2)
    assert robot.damping[at] - bare.damping[at] == pytest.approx(1.2)
    totals = {"armature": float(bare.armature[at]) + 0.2, "damping": float(bare.damping[at]) + 1.2}
    write_robot(tmp_path / "arm.xml", bare, at_joint, bare.nominal - bare.fixed, {"joint2": totals}, [])
    geared = np.array(log.command) * [1.0, 2.0, 1.0]
    run = closed_loop(robot, dataclasses.replace(log, command=geared)).z
    np.testing.assert_allclose(run, closed_loop(load_robot(at_joint), log).z, atol=1e-9)
    for factor in (1.5, 0.2):  # above and below what the actuator has
        wanted = {k: factor * v for k, v in totals.items()}
        write_robot(with_own, robot, tmp_path / "out.xml", robot.nominal - robot.fixed, {"joint2": wanted}, [])
        again = load_robot(tmp_path / "out.xml")
        assert {"armature": again.armature[at], "damping": again.damping[at]} == pytest.approx(wanted)


def test_inputs_that_no_log_holds_and_other_laws_are_refused(tmp_path):
    for more, said in (('input="pos ff"', "inputs pos ff"), ('ki="2" imax=".1"', "stops its integral at imax")):
        with pytest.raises(InputError, match=said):
            joint_drives(load_robot(pids(tmp_path, more)))
    for more, said in (
        ('cogging=".1 6 0"', "cogging or bristles.*leave cogging and lugre out"),
        ('inductance=".01 0"', "is a <dcmotor> with inductance"),
        ('input="pos ff" controller="8 0 1 0 0 0"', "inputs pos ff"),
    ):
        with pytest.raises(InputError, match=said) as error:
            joint_drives(load_robot(motors(tmp_path, more)))
        assert "\n" not in str(error.value)


def test_a_passive_motor_that_acts_is_refused(tmp_path):
    text = servo_mjcf(NOMINAL).replace(
        "<actuator>",
        '<actuator><dcmotor name="rubs" joint="joint3" input="none" resistance="1" motorconst="0 0" lugre="50 0 .1 .1 .1"/>', 1,
    )  # fmt: skip
    (tmp_path / "arm.xml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="'rubs' acts by itself"):
        load_robot(tmp_path / "arm.xml")


def test_a_passive_actuator_ahead_of_the_drives_shifts_no_control(tmp_path, log):
    text = servo_mjcf(NOMINAL).replace(
        "<actuator>", '<actuator><dcmotor name="still" joint="joint3" input="none" resistance="1" motorconst="0 0"/>', 1
    )
    (tmp_path / "with.xml").write_text(text, encoding="utf-8")
    (tmp_path / "arm.xml").write_text(servo_mjcf(NOMINAL), encoding="utf-8")
    robot = load_robot(tmp_path / "with.xml")
    assert robot.model.nactuator == 4
    assert mujoco.mj_name2id(robot.model, mujoco.mjtObj.mjOBJ_ACTUATOR, "still") == 0
    np.testing.assert_allclose(closed_loop(robot, log).z, closed_loop(load_robot(tmp_path / "arm.xml"), log).z, atol=1e-12)


def test_the_speed_limit_of_a_motor_is_an_effect_whose_slots_are_those_of_the_file(tmp_path, log):
    """A <general> in the place of the motor runs as the motor does once its speed limit is carried."""
    path = motors(tmp_path, 'nominal="4 20 2" input="pos" controller="{kp} 0 {kv} 0 0 4"')
    robot = load_robot(path)
    d = joint_drives(robot)[1]
    carried = effect_of_slots("joint2", "actuator", {name: d.slots[SLOT[name]] for name in ("stall", "no_load")})
    assert effect_slots(carried, robot) == {"stall": 20.0, "no_load": 2.0}
    servos = [NewServo(d.actuator, d.servo, dataclasses.replace(d.servo, zero=1e-9))]
    write_robot(path, robot, tmp_path / "out.xml", robot.nominal - robot.fixed, {}, [carried], servos)
    again = load_robot(tmp_path / "out.xml")
    assert joint_drives(again)[1].slots[SLOT["stall"]] == 0.0
    own = closed_loop(robot, log).z[:, 1]
    with_it = closed_loop(again, log, carried_effects(tmp_path / "out.xml")).z[:, 1]
    without = closed_loop(again, log).z[:, 1]
    assert np.std(with_it - own) < 0.02 * np.std(without - own)


def test_integral_action_that_is_found_at_a_motor_keeps_its_slewmax(tmp_path):
    path = motors(tmp_path, 'input="pos" controller="{kp} 0 {kv} 0.3 0 0"')
    robot = load_robot(path)
    d = joint_drives(robot)[1]
    servos = [NewServo(d.actuator, d.servo, d.servo, ki=5.0)]
    write_robot(path, robot, tmp_path / "out.xml", robot.nominal - robot.fixed, {}, [], servos)
    found = joint_drives(load_robot(tmp_path / "out.xml"))[1]
    assert (found.slots[SLOT["slew"]], found.slots[SLOT["integral"]]) == (0.3, 5.0)
