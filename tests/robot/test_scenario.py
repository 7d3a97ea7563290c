"""Scenarios of robots: exciting trajectories within the limits, logs that agree with their model, what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from lab.robot.arm import three_axes
from mjsim.crosscheck import Report, check_robot_model
from mjsim.errors import InputError
from mjsim.robot.exciting import Limits, _Search, exciting
from mjsim.robot.model import load_robot, robot_from
from mjsim.robot.recording import load_robot_recording
from mjsim.robot.scenario import robot_scenario, run_robot, shipped_robot_scenarios
from simgap.cli import cli
from simgap.commands.run import command

SHORT = {"duration_s": 5.0}
# a servo behind a gear with an offset, a servo of a slide, a finger that mirrors another one by a ratio, driven through a tendon
GRIPPER = """<mujoco><compiler angle="radian" autolimits="true"/><option timestep="0.001" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/></default><worldbody>
<body pos="0 0 .2"><joint name="lift" type="slide" axis="0 0 1" range="-.2 .2" damping="5"/><geom size=".05" mass="2"/>
 <body pos="0 0 .1"><joint name="wrist" axis="0 1 0" range="-1 1" armature=".05" damping=".2"/>
  <geom type="capsule" fromto="0 0 0 .2 0 0" size=".03" mass="1"/>
  <body pos=".2 .05 0"><joint name="left" type="slide" axis="0 1 0" range="0 .04" damping="20"/>
   <geom size=".02" mass=".1"/></body>
  <body pos=".2 -.05 0"><joint name="right" type="slide" axis="0 -1 0" range="0 .04"/><geom size=".02" mass=".1"/></body>
 </body></body></worldbody>
<tendon><fixed name="grip"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/></fixed></tendon>
<equality><joint joint1="right" joint2="left" polycoef="0.001 1 0 0 0" solref=".004 1"/></equality>
<actuator><position name="lift" joint="lift" kp="4000" kv="200"/>
<general name="wrist" joint="wrist" gear="2" gainprm="30" biasprm="3 -30 -2" biastype="affine"/>
<position name="grip" tendon="grip" gear="2" kp="800" kv="40"/></actuator></mujoco>"""


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer candidates of the trajectory, where any will do."""
    monkeypatch.setattr("mjsim.robot.exciting.TRIALS", 6)
    monkeypatch.setattr("mjsim.robot.exciting.ROUNDS", 2)


@pytest.fixture
def gripper(tmp_path: Path) -> Path:
    return write(tmp_path / "gripper.xml", GRIPPER)


def test_a_trajectory_keeps_its_limits_starts_at_rest_and_is_better_than_a_random_one() -> None:
    robot, t = robot_from(mujoco.MjModel.from_xml_string(three_axes().mjcf("arm"))), np.arange(0, 10, 0.004)
    limits = Limits(share=0.6, speed_rad_s=1.5)
    e = exciting(robot, np.random.default_rng(1), t, 0.1, 5, limits)
    low, high = robot.ranges.T
    assert np.all(np.abs(e.z - 0.5 * (low + high)) <= 0.6 * 0.5 * (high - low) * 1.05)
    assert np.all(np.max(np.abs(e.dz), axis=0) <= 1.5 * 1.05)
    np.testing.assert_allclose(e.dz[0], 0, atol=1e-12)
    np.testing.assert_allclose(e.ddz[0], 0, atol=1e-12)
    np.testing.assert_allclose(np.gradient(e.z, t, axis=0)[1:-1], e.dz[1:-1], atol=1e-3)
    np.testing.assert_allclose(np.gradient(e.dz, t, axis=0)[1:-1], e.ddz[1:-1], atol=1e-2)
    lines = np.abs(np.fft.rfft(e.z - e.z.mean(axis=0), axis=0))
    assert np.max(lines[6:]) < 1e-9 * np.max(lines), "no line above the fifth harmonic"
    search = _Search(robot, np.random.default_rng(2), 0.1, 5, np.ones(3, bool))
    search.limit(limits, 1.0)
    random = []
    for _ in range(20):
        c = search._at_rest(search.rng.standard_normal(search.shape))
        random.append(search._condition(*search.motion(c, search.scored, search.sizes(c))))
    assert e.condition < 0.7 * np.median(random)


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_robot_scenarios())
def test_shipped_scenarios_run_and_their_logs_can_be_read(name: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [name, "--out", str(tmp_path), "--duration", "4"], catch_exceptions=False)
    assert result.exit_code == 0
    log = load_robot_recording(tmp_path / f"{name}.csv", load_robot(robot_scenario(name).model_path))
    assert log.torque is not None
    assert len(log) == 1000
    told = json.loads((tmp_path / f"{name}.provenance.json").read_text())
    assert told["scenario"]["seed"] == 1
    assert 1 < told["trajectory"]["condition"] < 100


@pytest.mark.usefixtures("quick")
def test_a_log_shows_what_is_concealed(tmp_path: Path) -> None:
    """Torque of the log less that of the nominal model: the payload's weight, and Coulomb friction at its joint alone."""
    text = (
        'model = "arm3"\nduration_s = 5\n[excitation]\nkind = "fourier"\n[[effects]]\nid = "coulomb_friction"\n'
        'joint = "joint2"\ntorque_Nm = 2.0\n'
    )
    friction = run_robot(robot_scenario(write(tmp_path / "friction.toml", text)))
    plain = run_robot(robot_scenario("arm3", **SHORT))
    extra = friction.columns["joint2.torque_Nm"] - plain.columns["joint2.torque_Nm"]
    speed = friction.columns["joint2.velocity_rad_s"]
    clear = np.abs(speed) > 0.3
    off = np.abs(extra[clear] - 2.0 * np.sign(speed[clear]))  # the loop gives way by some mrad, and swings at reversals
    assert np.percentile(off, 75) < 0.1
    assert np.median(np.abs(friction.columns["joint1.torque_Nm"] - plain.columns["joint1.torque_Nm"])) < 0.02


@pytest.mark.usefixtures("quick")
def test_the_torque_of_a_motor_is_what_moves_it_behind_gear_and_gain(tmp_path: Path) -> None:
    text = three_axes().mjcf("arm").replace('<motor name="motor2" joint="joint2"/>',
                                            '<general name="motor2" joint="joint2" gear="50" gainprm="0.5"/>')  # fmt: skip
    geared = run_robot(robot_scenario(write(tmp_path / "geared.xml", text), **SHORT)).columns
    plain = run_robot(robot_scenario("arm3", **SHORT)).columns
    np.testing.assert_allclose(50 * geared["joint2.torque_Nm"], plain["joint2.torque_Nm"], atol=1e-6)
    np.testing.assert_allclose(geared["joint2.angle_rad"], plain["joint2.angle_rad"], atol=1e-9)


@pytest.mark.usefixtures("quick")
def test_servos_follow_through_gears_offsets_and_tendons(gripper: Path) -> None:
    robot = load_robot(gripper)
    assert robot.joints == ("lift", "wrist", "left")
    np.testing.assert_allclose(robot.gear, [1, 2, 2])
    np.testing.assert_allclose(robot.length, [0, 0, 0.001])
    log = run_robot(robot_scenario(gripper, **SHORT))
    assert "left.command_m" in log.columns
    assert "right.angle_m" not in log.columns
    np.testing.assert_allclose(log.columns["left.angle_m"], log.wanted.z[:, 2], atol=3e-3)
    assert log.columns["left.angle_m"][5] == pytest.approx(log.wanted.z[5, 2], abs=1e-4), "at rest the offset shows"
    np.testing.assert_allclose(log.columns["wrist.angle_rad"], log.wanted.z[:, 1], atol=0.1)
    np.testing.assert_allclose(log.qpos[:, 3], log.qpos[:, 2] + 0.001, atol=1e-12)


@pytest.mark.usefixtures("quick")
def test_a_model_that_touches_itself_everywhere_is_refused_and_one_that_seldom_does_moves_less(tmp_path: Path) -> None:
    text = (
        three_axes().mjcf("arm").replace('<geom contype="0" conaffinity="0" mass="0" group="1"/>', '<geom mass="0" group="1"/>')
    )
    with pytest.raises(InputError, match=r"touch in the middle of the joints' ranges.*keyframe"):
        run_robot(robot_scenario(write(tmp_path / "overlap.xml", text), **SHORT))
    ceiling = '<geom type="plane" pos="0 0 1.0" zaxis="0 0 -1" size="1 1 .1" contype="1" conaffinity="1"/><body name="column"'
    text = three_axes().mjcf("arm").replace('<body name="column"', ceiling)
    text = text.replace('name="tool" ', 'name="tool" contype="1" conaffinity="1" ')
    log = run_robot(robot_scenario(write(tmp_path / "ceiling.xml", text), **SHORT))
    data = mujoco.MjData(log.robot.model)
    for q in log.qpos[::50]:
        data.qpos[:] = q
        mujoco.mj_forward(log.robot.model, data)
        assert data.ncon == 0


@pytest.mark.usefixtures("quick")
def test_a_motor_that_is_too_weak_is_said(tmp_path: Path) -> None:
    text = three_axes().mjcf("arm").replace('joint="joint2"/>', 'joint="joint2" ctrlrange="-.1 .1"/>')
    with pytest.raises(InputError, match=r"joint2 needs .*, and its motor gives 0.1"):
        run_robot(robot_scenario(write(tmp_path / "weak.xml", text), **SHORT))


BAD = {
    "joint": ('[[effects]]\nid = "coulomb_friction"\njoint = "joint9"\ntorque_Nm = 1\n', "'joint9' is not in the model.*joint1"),
    "effect": ('[[effects]]\nid = "colomb_friction"\njoint = "joint1"\n', "did you mean 'coulomb_friction'"),
    "key": ('[[effects]]\nid = "coulomb_friction"\njoint = "joint1"\ntorque = 1\n', "unknown key 'torque'.*torque_Nm"),
    "lacking": ('[[effects]]\nid = "torque_ripple"\njoint = "joint1"\namplitude_Nm = 1\nphase_rad = 0\n', "no 'cycles_per_rev'"),
    "servo": ('[[effects]]\nid = "servo_deadband"\njoint = "joint1"\nhalf_width_rad = 0.1\n', "driven by a torque"),
    "value": ('[[effects]]\nid = "coulomb_friction"\njoint = "joint1"\ntorque_Nm = "a"\n', "torque_Nm = 'a'; expected a number"),
    "body": ('[payload]\nbody = "flang"\nmass = 1\n', "no body 'flang'.*forearm"),
    "number": ("[joints.joint1]\narmatur = 1\n", "key 'armatur' is not known.*did you mean 'armature'"),
    "moving": ('joints = ["elbow"]\n', "joints: joint 'elbow' is not in the model"),
    "misspelt": ("base = 1\n", r"\[excitation\]: key 'base' is not known.*base_hz"),
    "harmonics": ("harmonics = 1\n", "harmonics: input should be greater than or equal to 2"),
}


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", BAD)
def test_bad_scenarios_are_one_line(name: str, tmp_path: Path) -> None:
    text, match = BAD[name]
    path = write(tmp_path / "mine.toml", f'model = "arm3"\n[excitation]\nkind = "fourier"\n{text}')
    with pytest.raises(InputError, match=match) as caught:
        run_robot(robot_scenario(path, **SHORT))
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("quick")
def test_a_joint_without_a_motor_is_refused(tmp_path: Path) -> None:
    text = three_axes().mjcf("arm").replace('<motor name="motor3" joint="joint3"/>', "")
    with pytest.raises(InputError, match=r"joint 'joint3' has no actuator"):
        run_robot(robot_scenario(write(tmp_path / "passive.xml", text), **SHORT))


def test_an_axis_is_no_robot_and_an_engine_is_refused(tmp_path: Path) -> None:
    assert robot_scenario("coulomb_2") is None
    assert robot_scenario("robot_axis1") is None
    result = CliRunner().invoke(command, ["arm3", "--out", str(tmp_path / "o"), "--engine", "literal"])
    assert isinstance(result.exception, InputError)
    assert "a robot is stepped by MuJoCo" in str(result.exception)
    listed = CliRunner().invoke(command, ["--list"]).output
    assert all(name in listed for name in shipped_robot_scenarios())


@pytest.mark.slow
def test_the_equations_of_a_robot_are_those_of_mujoco(gripper: Path) -> None:
    *rows, report = check_robot_model(load_robot(gripper))
    assert isinstance(report, Report)
    assert report.missed == ()
    names = [r.name for r in rows]
    assert {"torque, wrist", "inertia, left", "servo, lift", "servo, wrist", "servo, left"} <= set(names)
    *rows, report = check_robot_model(load_robot(robot_scenario("arm3").model_path))
    assert report.missed == ()
    run = next(r for r in rows if r.name.startswith("free run"))
    assert [c.engine for c in run.cells] == ["exact", "literal"]


@pytest.mark.usefixtures("quick")
def test_a_model_that_mujoco_moves_otherwise_misses_its_tolerance(tmp_path: Path) -> None:
    text = three_axes().mjcf("arm").replace("<option ", '<option viscosity="3" ')
    path = write(tmp_path / "wet.xml", text)
    result = CliRunner().invoke(cli, ["crosscheck", str(path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 1
    found = json.loads((tmp_path / "out" / "crosscheck.json").read_text())
    assert any(line.startswith("torque, joint1") for line in found["missed"])
    assert (tmp_path / "out" / "crosscheck.png").stat().st_size > 1000
    assert all(math.isfinite(e["error"]) for r in found["rows"] for e in r["engines"].values())
