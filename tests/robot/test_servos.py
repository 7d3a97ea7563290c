"""Servo robots by command and position: a plant that shares no code conceals one thing, the diagnosis names it at its joint."""

from __future__ import annotations

import dataclasses
import json
import re

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from diagnose.result import Verdict
from diagnose.robot.options import RobotOptions
from diagnose.robot.picture import COLOURS, _hex, picture
from diagnose.robot.servos.fit import Number, slots_of, start_of
from diagnose.robot.servos.motion import joint_problem, prepare
from diagnose.robot.servos.pipeline import diagnose_servos
from diagnose.robot.servos.positions import resolution
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, command_for, servo_mjcf, simulate, write_servo_log
from mjsim.errors import CheckError, InputError
from mjsim.hold import delayed
from mjsim.robot.along import along
from mjsim.robot.carried import effect_slots
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.drives import has_servos, joint_drives
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import load_robot, robot_from
from mjsim.robot.recording import RobotRecording, load_robot_recording
from mjsim.robot.rows import link_rows
from mjsim.robot.write import carried_effects, write_robot
from simgap.commands.gate import command as gate
from simgap.robot import diagnose_robot_files

NOMINAL = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))
LAWS = ("coulomb_friction", "servo_deadband", "load_dependent_friction")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """``folder(robot)``: the nominal file and two logs of the robot."""

    def make(robot, seconds=6.0):
        out = tmp_path_factory.mktemp("servo")
        (out / "arm.xml").write_text(servo_mjcf(NOMINAL))
        for seed, name in ((1, "a"), (2, "b")):
            write_servo_log(robot, out / f"{name}.csv", seed, seconds)
        return out

    return make


def diagnosed(where, effects=LAWS, *, page=False):
    return diagnose_robot_files(
        [where / "a.csv"], where / "arm.xml", where / "out", [where / "b.csv"], RobotOptions(effects=effects), page=page
    )


@pytest.fixture(scope="module")
def rubbing(folder):
    """Dry friction at the second joint, a servo of two thirds of its gain at the third."""
    where = folder(NOMINAL.with_servo(1, friction=1.0).with_servo(2, kp=35.0))
    return where, diagnosed(where, page=True)


def test_dry_friction_is_named_at_its_joint_and_a_gain_is_a_number(rubbing):
    _, d = rubbing
    assert [(f.effect, f.joint) for f in d.findings] == [("coulomb_friction", "joint2")]
    e = d.findings[0].parameters["torque_Nm"]
    assert e.ci95[0] < 1.0 < e.ci95[1]
    assert e.ci95[1] - e.ci95[0] < 0.1
    assert [d.joints[f"joint{k}"].verdict for k in (1, 2, 3)] == [
        Verdict.NO_MISMATCH, Verdict.MISSING_PHYSICS, Verdict.PARAMETERS_ONLY,
    ]  # fmt: skip
    assert d.joints["joint3"].linear_parameters["kp"].value == pytest.approx(35.0, rel=0.02)
    assert any(line.startswith("kp of joint3: 50 -> 3") for line in d.changed)
    for joint in d.joints.values():
        assert joint.conditioning is not None
        assert joint.conditioning.rank == joint.conditioning.numbers
        assert 1.0 < joint.conditioning.condition < 1e6


def test_the_corrected_file_follows_the_log_in_mujoco(rubbing):
    where, d = rubbing
    model = mujoco.MjModel.from_xml_path(str(where / "out" / "corrected.xml"))
    assert model.dof_frictionloss[1] == pytest.approx(1.0, rel=0.02)
    assert -model.actuator_biasprm[2, 1] == pytest.approx(35.0, rel=0.02)
    assert carried_effects(where / "out" / "corrected.xml") == []
    for name in ("joint2", "joint3"):
        fit = d.joints[name].fit
        assert fit["corrected"].held_out_rms < 0.1 * fit["nominal"].held_out_rms
    # MuJoCo's semi-implicit step leads by half a step, 0.5 ms of motion, which the gains of corrected.xml take up
    assert d.joints["joint2"].fit["corrected"].held_out_rms < 2e-4
    kv = -model.actuator_biasprm[2, 2] + model.dof_damping[2]
    fitted = d.joints["joint3"].linear_parameters["kv + damping"]
    assert kv - fitted.value == pytest.approx(0.5 * model.opt.timestep * 35.0, rel=0.5)
    told = json.loads((where / "out" / "diagnosis.json").read_text())
    assert told["judged_on"]["channel"] == "angle"
    assert [row["role"] for row in told["closed_loop"]["joints"]["joint2"]] == ["estimation", "held-out"]
    page = (where / "out" / "report.html").read_text()
    assert "position under the recorded commands" in page
    assert '<figure class="robot">' in page
    assert "&lt;section" not in page
    assert page.count('data-explorer="joint-') == 3
    assert "All joints together" in page


def test_a_gate_compares_the_position_of_each_joint(rubbing):
    where, _ = rubbing
    words = [str(where / "a.csv"), str(where / "b.csv"), "--baseline", str(where / "out" / "diagnosis.json"), "--json"]
    ended = CliRunner().invoke(gate, [str(where / "arm.xml"), *words])
    assert ended.exit_code == 0, ended.exception
    checks = json.loads(ended.stdout)["checks"]
    assert [c["ratio"] for c in checks] == pytest.approx([1.0] * 6, abs=1e-6)
    assert {c["unit"] for c in checks} == {"rad"}
    ended = CliRunner().invoke(gate, [str(where / "arm.xml"), *words, "--against", "corrected"])
    assert isinstance(ended.exception, CheckError)
    assert {c["joint"] for c in json.loads(ended.stdout)["checks"] if c["grew"]} >= {"joint2", "joint3"}


def test_the_picture_is_rendered_or_a_plan_of_the_joints(rubbing, monkeypatch):
    where, d = rubbing
    robot = load_robot(where / "arm.xml")
    poses = np.linspace(0, 0.5, 9).reshape(3, 3)

    def refuse(*_):
        raise InputError("rendering", "no off-screen OpenGL", "EGL or OSMesa", "install it")

    monkeypatch.setattr("diagnose.robot.picture._rendered", refuse)
    plan = picture(d, robot, where / "arm.xml", poses)
    assert plan.count("<circle") == 3
    assert plan.count("<line") == 2
    assert "Coulomb friction" in plan
    assert f'fill="{_hex(COLOURS[Verdict.MISSING_PHYSICS])}"' in plan


@pytest.mark.slow
def test_a_dead_band_is_carried_and_runs_in_mujoco(folder):
    where = folder(NOMINAL.with_servo(2, dead_band=0.03), 4.0)
    d = diagnosed(where)
    assert [(f.effect, f.joint, f.place) for f in d.findings] == [("servo_deadband", "joint3", "actuator")]
    (carried,) = carried_effects(where / "out" / "corrected.xml")
    assert carried["parameters"]["half_width_rad"] == pytest.approx(0.03, rel=0.02)
    fit = d.joints["joint3"].fit
    assert fit["corrected"].held_out_rms < 0.1 * fit["nominal"].held_out_rms


@pytest.mark.slow
def test_a_cable_is_no_weight_and_no_spring(folder):
    where = folder(NOMINAL.with_servo(1, cable=2.0), 6.0)
    d = diagnosed(where, ("cable_torque", "gravity_load", "gravity_compensation_spring", "coulomb_friction"))
    assert [(f.effect, f.joint) for f in d.findings] == [("cable_torque", "joint2")]
    assert d.verdict is Verdict.MISSING_PHYSICS


@pytest.mark.slow
def test_a_robot_as_in_the_file_has_no_findings(folder):
    d = diagnosed(folder(NOMINAL, 4.0))
    assert d.verdict is Verdict.NO_MISMATCH
    assert not d.changed


@pytest.mark.slow
def test_a_payload_is_a_number_of_the_robot_and_no_physics(folder):
    arm = NOMINAL.arm.with_payload(0.5, NOMINAL.arm.links[-1].centre)
    where = folder(ServoRobot(arm, NOMINAL.servos), 4.0)
    d = diagnosed(where, (*LAWS, "gravity_load"))
    assert d.verdict is Verdict.PARAMETERS_ONLY
    assert not d.findings
    assert d.changed[0].startswith("payload on forearm: +0.")
    e = d.links["forearm.payload"]
    assert e.ci95[0] < 0.5 < e.ci95[1]
    assert e.ci95[1] - e.ci95[0] < 0.1
    mass = mujoco.MjModel.from_xml_path(str(where / "out" / "corrected.xml")).body_mass
    assert mass[3] == pytest.approx(2.1, abs=0.03)
    fit = d.joints["joint2"].fit
    assert fit["corrected"].held_out_rms < 0.1 * fit["nominal"].held_out_rms


@pytest.mark.slow
def test_one_delay_at_all_joints_is_said_to_be_perhaps_the_log(folder):
    late = NOMINAL
    for j in range(3):
        late = late.with_servo(j, delay=0.06)
    d = diagnosed(folder(late, 6.0), ("time_delay", "actuator_lag"))
    assert {(f.effect, f.joint) for f in d.findings} == {("time_delay", f"joint{j}") for j in (1, 2, 3)}
    told = [m for n in d.notes if (m := re.search(r"3 of 3 joints have a delay of (\S+) ms in common", n))]
    assert [float(m[1]) for m in told] == [pytest.approx(60.0, abs=1.0)]


@pytest.mark.slow
def test_a_scale_that_is_not_told_is_taken_from_like_servos_and_said(folder):
    like = ServoRobot(three_axes(), tuple(ServoJoint(60.0, 6.0) for _ in range(3)))
    where = folder(ServoRobot(three_axes(), tuple(ServoJoint(45.0, 5.0) for _ in range(3))))
    text = servo_mjcf(like).replace('armature="0.06"', 'armature="0.05"').replace('armature="0.08"', 'armature="0.05"')
    text = text.replace('armature="0.03"', 'armature="0.05"')
    for damping in ("0.5", "0.8", "0.3"):
        text = text.replace(f'damping="{damping}"', 'damping="0.4"')
    (where / "arm.xml").write_text(text)
    d = diagnosed(where, ("coulomb_friction",))
    assert any("joint1: Command and position tell only ratios here" in n and "joint2, joint3" in n for n in d.notes)
    assert any(line.startswith("kp of joint1: 60 -> ") and "by the scale that is assumed" in line for line in d.changed)
    kp = d.joints["joint1"].linear_parameters["kp"]
    assert kp.value == pytest.approx(45.0, rel=0.2)
    assert kp.ci95[1] - kp.ci95[0] < 60.0
    ratio = d.joints["joint1"].linear_parameters["(kv + damping) / kp"]
    assert ratio.value == pytest.approx(5.5 / 45.0, rel=0.02)


@pytest.fixture(scope="module")
def robot():
    return robot_from(mujoco.MjModel.from_xml_string(servo_mjcf(NOMINAL)))


@pytest.fixture(scope="module")
def recording(robot):
    """Six seconds of the nominal robot."""
    t = np.arange(0, 6.0, 0.01)
    command = command_for(NOMINAL, np.random.default_rng(4), t)
    return RobotRecording(t, robot.joints, 0.01, simulate(NOMINAL, command, 0.01), command=command)


def test_what_a_joint_carries_agrees_with_the_regressor(robot):
    rng = np.random.default_rng(0)
    z, dz, ddz = (scale * rng.standard_normal((5, 3)) for scale in (0.5, 1.0, 2.0))
    series = along(robot, z, dz, ddz)

    def torque(z, dz, ddz):
        return np.einsum("nmlk,lk->nm", link_rows(robot, z, dz, ddz), robot.nominal)

    np.testing.assert_allclose(series.torque, torque(z, dz, ddz), rtol=1e-10, atol=1e-12)
    for j in range(3):
        step = np.zeros_like(z)
        step[:, j] = 1e-5
        for found, ends in (
            (series.by_position, (torque(z + step, dz, ddz), torque(z - step, dz, ddz))),
            (series.by_velocity, (torque(z, dz + step, ddz), torque(z, dz - step, ddz))),
            (series.inertia, (torque(z, dz, ddz + step), torque(z, dz, ddz - step))),
        ):
            np.testing.assert_allclose(found[:, j], (ends[0] - ends[1])[:, j] / 2e-5, rtol=1e-4, atol=1e-4)


def test_one_joint_and_all_joints_in_mujoco_run_alike(robot, recording):
    """Both follow the sealed plant: the kernel exactly to its step, MuJoCo to half a timestep of motion."""
    r = recording
    run = closed_loop(robot, r)
    assert not run.diverged
    speed = np.max(np.abs(np.gradient(r.angle, r.dt, axis=0)))
    assert np.max(np.abs(run.z - r.angle)[50:]) < 2 * speed * float(robot.model.opt.timestep)
    m = prepare(robot, r, False)
    for name in robot.joints:
        p = joint_problem(robot, [m], name, True)
        assert np.max(np.abs(p.error(p.nominal))[50:]) < 1.5e-3


@pytest.mark.parametrize(
    ("change", "effect"),
    [
        ({"dead_band": 0.05}, {"effect": "servo_deadband", "parameters": {"half_width_rad": 0.05}}),
        ({"slew": 0.3}, {"effect": "velocity_limit", "parameters": {"limit_rad_s": 0.3}}),
        ({"delay": 0.05}, {"effect": "time_delay", "parameters": {"delay_s": 0.05}}),
        ({"load": 0.2}, {"effect": "load_dependent_friction", "parameters": {"coefficient": 0.2}}),
        ({"friction": 0.5, "extra": 0.7, "speed": 0.2},
         {"effect": "stribeck_friction",
          "parameters": {"torque_Nm": 0.5, "extra_static_torque_Nm": 0.7, "stribeck_velocity_rad_s": 0.2}}),
        ({"ripple": 0.8, "order": 9.0},
         {"effect": "torque_ripple", "parameters": {"amplitude_Nm": 0.8, "cycles_per_rev": 9.0, "phase_rad": 0.0}}),
        ({"source": 2, "couple": 0.8},
         {"effect": "coupled_transmission", "from": "joint3", "parameters": {"ratio": 0.8}}),
        ({"source": 0, "drag": 0.9},
         {"effect": "coupled_transmission", "from": "joint1", "parameters": {"torque_Nm": 0.9, "viscous": 0.0}}),
        ({"stall": 14.0, "no_load": 2.0},
         {"effect": "torque_speed_limit", "parameters": {"stall_torque_Nm": 14.0, "no_load_speed_rad_s": 2.0}}),
    ],
)  # fmt: skip
def test_a_law_acts_alike_in_the_sealed_plant_the_kernel_and_mujoco(robot, change, effect):
    t = np.arange(0, 2.5, 0.01)
    command = command_for(NOMINAL, np.random.default_rng(4), t)
    q = simulate(NOMINAL.with_servo(1, **change), command, 0.01)
    r = RobotRecording(t, robot.joints, 0.01, q, command=command)
    whole = {**effect, "joint": "joint2"}
    p = joint_problem(robot, [prepare(robot, r, False)], "joint2", True)
    slots = p.nominal.copy()
    for name, value in effect_slots(whole, robot).items():
        slots[SLOT[name]] = value
    without = np.sqrt(np.mean(p.error(p.nominal) ** 2))
    assert (
        np.sqrt(np.mean(p.error(slots)[30:] ** 2)) < 0.06 * without
    )  # the start from rest is smoothed in the other joints' motion
    run = closed_loop(robot, r, [whole])
    assert np.sqrt(np.mean((run.z - q)[:, 1] ** 2)) < 0.12 * without


@pytest.mark.parametrize(
    ("change", "effect"),
    [
        ({"load": 0.3}, {"effect": "load_dependent_friction", "parameters": {"coefficient": 0.3}}),
        ({"friction": 1.0, "extra": 0.5, "speed": 0.2},
         {"effect": "stribeck_friction",
          "parameters": {"torque_Nm": 1.0, "extra_static_torque_Nm": 0.5, "stribeck_velocity_rad_s": 0.2}}),
    ],
)  # fmt: skip
def test_friction_that_a_corrected_file_carries_holds_a_joint_under_load(robot, tmp_path, change, effect):
    """MuJoCo's default softness of dry friction lets it creep by 10 mrad here: the file has to make it stiff."""
    t = np.arange(0, 6.0, 0.01)
    command = 0.3 * np.minimum(t, 1.0)[:, None] * np.ones(3)
    q = simulate(NOMINAL.with_servo(1, **change), command, 0.01)
    nominal, out = tmp_path / "arm.xml", tmp_path / "corrected.xml"
    nominal.write_text(servo_mjcf(NOMINAL))
    write_robot(
        nominal, robot, out, robot.nominal - robot.fixed, {"joint2": {"frictionloss": 0.0}}, [{**effect, "joint": "joint2"}]
    )
    r = RobotRecording(t, robot.joints, 0.01, q, command=command)
    error = (closed_loop(load_robot(out), r, carried_effects(out)).z - q)[:, 1]
    assert np.max(np.abs(error[150:])) < 5e-4
    assert np.ptp(q[200:, 1]) < 1e-6  # it sticks, off its command
    assert abs(q[-1, 1] - 0.3) > 0.02


def test_a_position_that_is_logged_late_is_late_in_the_kernel_and_in_mujoco(robot, recording):
    r = recording
    p = joint_problem(robot, [prepare(robot, r, False)], "joint2", True)
    slots = p.nominal.copy()
    slots[SLOT["late"]] = 0.045
    effect = {"effect": "time_delay", "place": "sensor", "joint": "joint2", "parameters": {"delay_s": 0.045}}
    assert effect_slots(effect, robot) == {"late": 0.045}
    for plain, late in (
        (p.run(p.nominal)[0], p.run(slots)[0]),
        (closed_loop(robot, r).z[:, 1], closed_loop(robot, r, [effect]).z[:, 1]),
    ):
        between = np.interp(r.time[10:] - 0.045, r.time, plain)
        np.testing.assert_allclose(late[10:], between, atol=2e-4)
    t = np.arange(200) * 0.01
    np.testing.assert_allclose(delayed(np.sin(t), -2.4)[5:-5], np.sin(t + 0.024)[5:-5], atol=1e-8)


@pytest.mark.slow  # two to three searches at all joints, a minute together
@pytest.mark.parametrize(("late", "delay"), [({1: 4}, 0.0), ({}, 0.04)])
def test_a_late_column_and_a_late_servo_are_told_by_the_other_joints(tmp_path, late, delay):
    (tmp_path / "arm.xml").write_text(servo_mjcf(NOMINAL))
    for seed, name in ((1, "a"), (2, "b")):
        write_servo_log(NOMINAL.with_servo(1, delay=delay), tmp_path / f"{name}.csv", seed, 10.0, 100.0, base=0.1, late=late)
    d = diagnosed(tmp_path, ("time_delay", "actuator_lag", "coulomb_friction"))
    (f,) = d.findings
    assert (f.effect, f.joint, f.place) == ("time_delay", "joint2", "sensor" if late else "actuator")
    assert f.parameters["delay_s"].value == pytest.approx(0.04, abs=1e-3)
    assert "By all joints together" in f.sentence
    assert "time_delay" not in f.equivalents
    assert d.joints["joint1"].verdict is Verdict.NO_MISMATCH


def test_the_sum_of_gain_and_damping_is_shared_as_the_file_has_it(robot, recording):
    p = joint_problem(robot, [prepare(robot, recording, False)], "joint2", True)
    n = (Number("damp"),)
    assert float(start_of(n, p.nominal)[0]) == pytest.approx(np.log(8.8))
    less = slots_of(p, n, np.log([0.5]), p.nominal)
    assert (less[SLOT["kv"]], less[SLOT["damping"]]) == pytest.approx((0.0, 0.5))
    more = slots_of(p, n, np.log([9.8]), p.nominal)
    assert (more[SLOT["kv"]], more[SLOT["damping"]]) == pytest.approx((9.0, 0.8))


def test_resolution_is_that_of_the_steps_or_of_the_noise():
    t = np.arange(2000) * 0.01
    q = np.sin(0.3 * t)
    assert resolution(0.01 * np.round(q / 0.01)) == pytest.approx(0.01 / np.sqrt(12), rel=0.2)
    noisy = q + 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    assert resolution(noisy) == pytest.approx(1e-3, rel=0.1)


def test_bad_servo_logs_are_refused_in_one_line(robot, recording, tmp_path):
    assert has_servos(robot)
    assert all(d is not None and not d.velocity for d in joint_drives(robot))
    r = recording
    with pytest.raises(InputError, match="no joint that a servo drives"):
        diagnose_servos(robot, [dataclasses.replace(r, command=None)])
    with pytest.raises(InputError, match="one of joint1"):
        diagnose_servos(robot, [r], options=RobotOptions(joints=("joint1x",)))
    still = dataclasses.replace(r, angle=np.column_stack([r.angle[:, 0], np.zeros((len(r), 2))]))
    with pytest.raises(InputError, match="'joint2' does not move"):
        diagnose_servos(robot, [still], options=RobotOptions(joints=("joint2",)))
    arm = load_robot_path(tmp_path)
    path = tmp_path / "log.csv"
    path.write_text("time_s,joint1x.angle_rad\n0,0\n")
    with pytest.raises(InputError, match="one of joint1"):
        load_robot_recording(path, arm)


def load_robot_path(where):
    (where / "arm.xml").write_text(servo_mjcf(NOMINAL))
    return load_robot(where / "arm.xml")
