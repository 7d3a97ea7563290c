"""The check of a robot's log: each fault of a column is named at its joint, and a sound log is ready."""

from __future__ import annotations

import dataclasses
import json

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from diagnose.check import LogVerdict, Severity
from diagnose.robot.check.channels import clipped_torque
from diagnose.robot.check.relations import relate
from diagnose.robot.check.run import check_robot
from lab.robot.arm import three_axes
from lab.robot.cases import trajectory
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, simulate
from mjsim.errors import InputError
from mjsim.robot.model import load_robot, robot_from
from mjsim.robot.recording import RobotRecording
from simgap.commands.check import command as check_command
from simgap.robot import checked, diagnose_robot_recordings

NOMINAL = ServoRobot(three_axes(), (ServoJoint(60.0, 6.0), ServoJoint(90.0, 8.0), ServoJoint(50.0, 4.0)))
TRUE = NOMINAL.with_servo(1, friction=1.0).with_servo(2, kp=35.0)
DT = 0.01


@pytest.fixture(scope="module")
def robot():
    return robot_from(mujoco.MjModel.from_xml_string(servo_mjcf(NOMINAL)))


@pytest.fixture(scope="module")
def log(robot):
    t = np.arange(0, 10.0, DT)
    command = command_for(NOMINAL, np.random.default_rng(4), t, 0.1)
    q = simulate(TRUE, command, DT)
    velocity = np.gradient(q, DT, axis=0)
    return RobotRecording(t, robot.joints, DT, q, command=command, velocity=velocity, source="log.csv")


@pytest.fixture(scope="module")
def by_force():
    t = np.arange(0, 8.0, 0.004)
    q, v, a = trajectory(NOMINAL.arm, np.random.default_rng(3), t, tries=1)
    torque = NOMINAL.arm.torque(q, v, a) + [x.rotor for x in NOMINAL.arm.links] * a + 0.1 * np.sign(v)
    robot = robot_from(mujoco.MjModel.from_xml_string(NOMINAL.arm.mjcf("arm")))
    return robot, RobotRecording(t, robot.joints, 0.004, q, torque=torque, source="force.csv")


def changed(log, channel, joint, change):
    values = np.array(getattr(log, channel))
    values[:, joint] = change(values[:, joint])
    return dataclasses.replace(log, **{channel: values})


def told(check):
    return [(p.channel, p.problem, p.severity) for p in check.problems]


def test_a_sound_log_of_a_robot_that_is_not_as_in_the_file_is_ready(robot, log):
    check = check_robot(robot, [log])
    assert check.verdict is LogVerdict.READY
    assert set(check.understood) == {"robot", "log", "joint1", "joint2", "joint3"}
    assert "hinge, servo; channels command, velocity, angle" in check.understood["joint2"]


@pytest.mark.parametrize(
    ("channel", "joint", "change", "problem"),
    [
        ("angle", 1, lambda x: -x, "sign"),
        ("angle", 0, lambda x: np.degrees(x), "unit"),
        ("angle", 2, lambda x: 7.0 * x / 5, None),
        ("velocity", 1, lambda x: x * 30 / np.pi, "unit"),
        ("velocity", 2, lambda x: -x, "sign"),
        ("velocity", 0, lambda x: np.roll(x, 3), "skew"),
        ("angle", 2, lambda x: np.concatenate([x[30:], np.full(30, x[-1])]), "skew"),
        ("angle", 0, lambda x: x + 4.0, "joint_range"),
        ("angle", 1, lambda x: np.clip(x, np.quantile(x, 0.2), np.inf), "clipping"),
        ("velocity", 2, lambda x: np.clip(x, -np.inf, np.quantile(x, 0.9)), "clipping"),
    ],
)
def test_a_fault_of_a_servo_log_is_named_at_its_joint(robot, log, channel, joint, change, problem):
    bare = log if channel == "velocity" else dataclasses.replace(log, velocity=None)
    found = told(check_robot(robot, [changed(bare, channel, joint, change)]))
    assert found == ([] if problem is None else [(f"joint{joint + 1}.{channel}", problem, Severity.FIX)])


@pytest.mark.parametrize(
    ("channel", "change", "problem"),
    [
        ("angle", lambda x: 0.02 * np.round(x / 0.02), "quantisation"),
        ("velocity", lambda x: 0.2 * np.round(x / 0.2), "quantisation"),
        ("velocity", lambda x: np.clip(x, -np.inf, np.quantile(x, 0.97)), "clipping"),
    ],
)
def test_a_channel_that_is_coarse_or_a_little_clipped_limits(robot, log, channel, change, problem):
    bare = log if channel == "velocity" else dataclasses.replace(log, velocity=None)
    assert told(check_robot(robot, [changed(bare, channel, 1, change)])) == [(f"joint2.{channel}", problem, Severity.LIMITS)]


def test_rows_that_repeat_the_row_before_are_told_and_rest_is_not(robot, log):
    angle = np.array(log.angle)
    angle[100:700:10] = angle[99:699:10]
    bare = dataclasses.replace(log, velocity=None)
    (p,) = check_robot(robot, [dataclasses.replace(bare, angle=angle)]).problems
    assert (p.channel, p.problem, p.severity) == ("time", "duplicated_rows", Severity.LIMITS)
    assert p.value == pytest.approx(0.06, abs=0.01)
    resting = np.concatenate([np.repeat(log.angle[:1], 300, axis=0), log.angle])
    command = np.concatenate([np.repeat(log.command[:1], 300, axis=0), log.command])
    rest = RobotRecording(np.arange(len(resting)) * DT, log.joints, DT, resting, command=command, source="rest.csv")
    assert check_robot(robot, [rest]).verdict is LogVerdict.READY


def test_motion_that_leaves_the_limits_is_told_with_where(robot, log):
    model = mujoco.MjModel.from_xml_string(servo_mjcf(NOMINAL))
    q = log.angle[:, 0]
    model.jnt_limited[0] = 1
    model.jnt_range[0] = float(np.min(q)) - 0.1, float(np.max(q)) - 0.02
    (p,) = check_robot(robot_from(model), [dataclasses.replace(log, velocity=None)]).problems
    assert (p.channel, p.problem, p.severity) == ("joint1.angle", "joint_range", Severity.LIMITS)
    assert p.value == pytest.approx(0.02, abs=1e-3)
    assert len(p.marks) >= 1


def test_a_torque_is_clipped_by_the_log_or_by_the_drive(by_force):
    robot, log = by_force
    limit = float(np.quantile(log.torque[:, 1], 0.85))
    (p,) = check_robot(robot, [changed(log, "torque", 1, lambda x: np.minimum(x, limit))]).problems
    assert (p.channel, p.problem, p.severity) == ("joint2.torque", "clipping", Severity.FIX)
    assert p.value == pytest.approx(limit)
    torque = np.minimum(log.torque[:, 1], limit)
    v = np.gradient(log.angle[:, 1], log.dt)
    assert not clipped_torque("joint2", torque, torque + 0.01 * np.sin(50 * log.time), v, "N m", log.time)


def test_swapped_commands_are_told_by_correlation(robot, log):
    swapped = np.array(log.command)[:, [2, 1, 0]]
    (p,) = check_robot(robot, [dataclasses.replace(log, command=swapped)]).problems
    assert (p.channel, p.problem) == ("joint1.command", "swapped")
    assert p.value > 0.9
    assert "swap the columns of the command of joint1 and joint3" in p.advice


def test_a_position_that_is_late_limits_since_a_lag_looks_alike(robot, log):
    late = changed(dataclasses.replace(log, velocity=None), "angle", 0, lambda x: np.concatenate([np.full(40, x[0]), x[:-40]]))
    assert told(check_robot(robot, [late])) == [("joint1.angle", "skew", Severity.LIMITS)]


def test_a_joint_that_stands_still_and_a_slow_log_limit(robot, log):
    still = changed(dataclasses.replace(log, velocity=None), "angle", 0, np.zeros_like)
    assert told(check_robot(robot, [still])) == [("joint1.angle", "constant", Severity.LIMITS)]
    every = slice(None, None, 20)
    slow = dataclasses.replace(
        log, time=log.time[every], dt=20 * DT, angle=log.angle[every], command=log.command[every], velocity=None
    )
    assert {p.problem for p in check_robot(robot, [slow]).problems} == {"sample_rate"}


def test_time_in_milliseconds_is_told(robot, log):
    bare = dataclasses.replace(log, velocity=None, time=1e3 * log.time, dt=1e3 * DT)
    assert told(check_robot(robot, [bare])) == [("time", "unit", Severity.FIX)]


@pytest.mark.parametrize(
    ("factor", "problem"), [(1.0, None), (1.5, None), (3.0, None), (-1.0, "sign"), (1000.0, "unit"), (6.0, "channel_ratio")]
)
def test_a_torque_is_compared_with_what_the_motion_needs(by_force, factor, problem):
    robot, log = by_force
    found = told(check_robot(robot, [changed(log, "torque", 1, lambda x: factor * x)]))
    assert found == ([] if problem is None else [("joint2.torque", problem, Severity.FIX)])


def test_a_torque_behind_the_gear_is_told_and_refused(by_force, tmp_path):
    _, log = by_force
    text = NOMINAL.arm.mjcf("arm")
    for joint in (1, 2, 3):
        text = text.replace(f'joint="joint{joint}"/>', f'joint="joint{joint}" gear="50"/>')
    model = tmp_path / "arm.xml"
    model.write_text(text)
    geared = load_robot(model)
    assert [p[:2] for p in told(check_robot(geared, [log]))] == [(f"joint{j}.torque", "gear") for j in (1, 2, 3)]
    with pytest.raises(InputError, match=r"a gain of 0.02 in the binding.*--accept-log"):
        diagnose_robot_recordings([log], model, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    before = dataclasses.replace(log, torque=log.torque / 50)
    assert check_robot(geared, [before]).verdict is LogVerdict.READY
    assert checked(geared, [log], accept_log=True).verdict is LogVerdict.FIX


def test_swapped_torques_are_told(by_force):
    robot, log = by_force
    (p,) = check_robot(robot, [dataclasses.replace(log, torque=np.array(log.torque)[:, [1, 0, 2]])]).problems
    assert (p.channel, p.problem) == ("joint1.torque", "swapped")


@pytest.mark.parametrize("delay", [-3.4, 0.0, 7.25])
def test_a_relation_tells_slope_and_delay_to_a_part_of_a_sample(delay):
    t = np.arange(1000) * DT
    x, y = (np.sin(2 * s) + 0.4 * np.sin(5.1 * s) for s in (t, t - delay * DT))
    found = relate(x, -2.0 * y + 1.0, DT)
    assert found.delay == pytest.approx(delay * DT, abs=0.2 * DT)
    assert found.slope == pytest.approx(-2.0, rel=0.02)
    assert relate(np.ones(1000), y, DT) is None


def test_a_sine_late_by_half_its_period_has_no_sign_that_can_be_told(robot, log):
    t = np.arange(1000) * DT
    joint = log.joints.index("joint2")

    def problems(harmonic):
        def wave(s):
            return 0.1 * np.sin(2 * np.pi * s / 0.8) + harmonic * np.sin(0.9 * s)

        command, angle = np.array(log.command), np.array(log.angle)
        command[:, joint], angle[:, joint] = wave(t), -wave(t)
        reversed_ = dataclasses.replace(log, command=command, angle=angle, velocity=None)
        return {p.problem for p in check_robot(robot, [reversed_]).problems if p.channel == "joint2.angle"}

    assert "sign" not in problems(0.0)
    assert "sign" in problems(0.3)  # which the other sign follows at no delay
    found = relate(np.sin(2 * np.pi * t / 0.8), -np.sin(2 * np.pi * t / 0.8), DT)
    assert found.explained == pytest.approx(found.opposite, abs=1e-6)


def test_the_command_gives_exit_codes_and_files(robot, log, tmp_path):
    (tmp_path / "arm.xml").write_text(servo_mjcf(NOMINAL))
    names = [f"joint{k}.{c}" for c in ("command_rad", "angle_rad") for k in (1, 2, 3)]

    def run(name, target, *more):
        rows = np.column_stack([log.time, target, log.angle])
        np.savetxt(tmp_path / name, rows, delimiter=",", header=",".join(["time_s", *names]), comments="", fmt="%.9g")
        return CliRunner().invoke(check_command, [str(tmp_path / name), "--model", str(tmp_path / "arm.xml"), *more])

    good = run("good.csv", log.command, "--out", str(tmp_path / "out"))
    assert good.exit_code == 0
    assert json.loads((tmp_path / "out" / "check.json").read_text())["verdict"] == "ready"
    assert "joint3: position and command" in (tmp_path / "out" / "check.html").read_text()
    swapped = run("swapped.csv", np.array(log.command)[:, [2, 1, 0]], "--json")
    assert swapped.exit_code == 1
    assert json.loads(swapped.output)["problems"][0]["problem"] == "swapped"
