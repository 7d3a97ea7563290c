"""Films of a user's own model: its geoms, cameras and lights; a recording as a ghost or beside the simulation."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as iio
import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from mjsim.errors import InputError
from mjsim.render import Rig, Scene, Style, Take, context
from mjsim.render.own import film_takes, magnified, moments
from mjsim.render.take import recorded, simulated
from simgap.commands.render import command

PENDULUM = """<mujoco model="pendulum"><compiler angle="radian"/><option timestep="0.001"/><worldbody>{more}
<body name="rod" pos="0 0 1"><joint name="hinge" axis="0 1 0" damping="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.2" rgba="0.8 0.5 0.1 1" {group}/>
<geom name="bob" type="sphere" pos="0 0 -0.5" size="0.07" mass="1" rgba="0.2 0.3 0.8 1" {group}/></body></worldbody>
<actuator><motor name="m" joint="hinge"/></actuator></mujoco>"""
ARM = """<mujoco model="arm"><compiler angle="radian"/><default><joint damping="0.5"/></default><worldbody>
<body name="upper" pos="0 0 .3"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .4" size=".04"/>
<body name="lower" pos="0 0 .4"><joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .3" size=".03"/>
</body></body></worldbody><actuator>{kind}</actuator>
<keyframe><key name="home" qpos="0.3 0.9" ctrl="{ctrl}"/></keyframe></mujoco>"""
SERVOS = '<position name="s" joint="shoulder" kp="100" kv="5"/><position name="e" joint="elbow" kp="60" kv="3"/>'
MOTORS = '<motor name="s" joint="shoulder"/><motor name="e" joint="elbow"/>'
MINE = '<light name="mine" pos="0 0 3"/><geom type="plane" size="1 1 .1"/><camera name="cam" pos="0 -3 1"/>'
N, DT = 400, 0.005
TIME = DT * np.arange(N)
ANGLE = 0.3 * np.sin(3 * TIME)


@pytest.fixture
def pendulum(tmp_path: Path) -> Path:
    (tmp_path / "pendulum.xml").write_text(PENDULUM.format(more="", group=""))
    table = np.column_stack([TIME, np.sin(3 * TIME), np.gradient(ANGLE, DT), ANGLE])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="")
    return tmp_path


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    (tmp_path / "arm.xml").write_text(ARM.format(kind=SERVOS, ctrl="0.3 0.9"))
    table = np.column_stack([TIME, 0.3 + ANGLE, 0.9 - ANGLE, 0.3 + ANGLE, 0.9 - ANGLE])
    names = "time_s,shoulder.command_rad,elbow.command_rad,shoulder.angle_rad,elbow.angle_rad"
    np.savetxt(tmp_path / "robot.csv", table, delimiter=",", header=names, comments="")
    table = np.column_stack([TIME, 0 * TIME + np.sin(TIME), 0.9 + ANGLE])
    np.savetxt(tmp_path / "elbow.csv", table, delimiter=",", header="time_s,torque_Nm,angle_rad", comments="")
    return tmp_path


@pytest.fixture(scope="module")
def screen() -> None:
    try:
        context.backend()
    except InputError as error:
        pytest.skip(str(error))


def test_a_recording_poses_its_joint(pendulum):
    rig = Rig.of(pendulum / "pendulum.xml")
    take = recorded(rig, pendulum / "log.csv")
    np.testing.assert_allclose(take.qpos[:, 0], ANGLE, atol=1e-12)
    assert [c.name for c in take.curves] == ["torque", "angle", "velocity"]


def test_a_simulation_is_that_of_plain_mujoco(pendulum):
    rig = Rig.of(pendulum / "pendulum.xml")
    take = simulated(rig, pendulum / "log.csv")
    model = mujoco.MjModel.from_xml_path(str(pendulum / "pendulum.xml"))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = ANGLE[0], 0.9
    for k in range(100):
        np.testing.assert_allclose(take.qpos[k, 0], data.qpos[0], atol=2e-3)
        data.ctrl[0] = np.sin(3 * TIME[k])
        for _ in range(5):
            mujoco.mj_step(model, data)


def test_a_robot_log_poses_every_joint_and_its_commands_drive_the_servos(arm):
    rig = Rig.of(arm / "arm.xml")
    assert rig.axis is None
    take = recorded(rig, arm / "robot.csv")
    np.testing.assert_allclose(take.qpos, np.column_stack([0.3 + ANGLE, 0.9 - ANGLE]), atol=1e-12)
    run = simulated(rig, arm / "robot.csv")
    assert np.max(np.abs(run.qpos - take.qpos)) < 0.3  # it follows
    assert np.ptp(run.qpos[:, 1]) > 0.3
    np.testing.assert_allclose(run.qpos[0], take.qpos[0])


def test_one_joint_of_several_is_named_and_the_others_are_held(arm):
    with pytest.raises(InputError, match="one of: shoulder, elbow; name it by --joint"):
        recorded(Rig.of(arm / "arm.xml"), arm / "elbow.csv")
    with pytest.raises(InputError, match="did you mean 'elbow'"):
        Rig.of(arm / "arm.xml", "elbo")
    rig = Rig.of(arm / "arm.xml", "elbow")
    take = recorded(rig, arm / "elbow.csv")
    np.testing.assert_allclose(take.qpos[:, 0], 0.3)  # the keyframe's
    np.testing.assert_allclose(take.qpos[:, 1], 0.9 + ANGLE, atol=1e-12)
    with pytest.raises(InputError, match=r"is a servo.*elbow.command_rad"):
        simulated(rig, arm / "elbow.csv")
    (arm / "arm.xml").write_text(ARM.format(kind=MOTORS, ctrl="0 0"))
    run = simulated(Rig.of(arm / "arm.xml", "elbow"), arm / "elbow.csv")
    assert np.ptp(run.qpos[:, 0]) < 1e-5
    assert np.ptp(run.qpos[:, 1]) > 0.05


def test_a_joint_that_follows_another_by_an_equality(tmp_path):
    xml = PENDULUM.format(more='<body><joint name="gear" axis="0 1 0"/><geom size="0.1" mass="1"/></body>', group="")
    xml = xml.replace("<actuator>", '<equality><joint joint1="gear" joint2="hinge" polycoef="0 3 0 0 0"/></equality><actuator>')
    (tmp_path / "geared.xml").write_text(xml)
    rig = Rig.of(tmp_path / "geared.xml", "hinge")
    names = [rig.model.joint(j).name for j in range(2)]
    poses = rig.with_joints({names.index("hinge"): ANGLE})
    np.testing.assert_allclose(poses[:, names.index("gear")], 3 * ANGLE)
    poses = rig.with_joints({names.index("gear"): ANGLE})
    np.testing.assert_allclose(poses[:, names.index("hinge")], ANGLE / 3)


def test_what_a_file_lacks_is_added_and_what_it_has_is_kept(pendulum):
    poses = ANGLE[:, None]
    bare = Scene(pendulum / "pendulum.xml", poses)
    assert bare.moves
    assert bare.model.nlight == 1
    assert mujoco.mjtGeom.mjGEOM_PLANE in bare.model.geom_type
    own = PENDULUM.format(more=MINE, group="")
    (pendulum / "own.xml").write_text(own)
    kept = Scene(pendulum / "own.xml", poses)
    assert [kept.model.light(i).name for i in range(kept.model.nlight)] == ["mine"]
    assert kept.model.ngeom == 3
    assert kept.camera.type == mujoco.mjtCamera.mjCAMERA_FIXED
    assert Scene(pendulum / "own.xml", poses, "free").camera.type == mujoco.mjtCamera.mjCAMERA_FREE
    with pytest.raises(InputError, match="did you mean 'cam'"):
        Scene(pendulum / "own.xml", poses, "came")


def test_the_free_camera_sees_all_of_the_motion(pendulum):
    """All corners of what moves project into the picture, and not into a small part of it."""
    poses = np.linspace(-2, 2, 50)[:, None]
    for aspect in (0.5, 1.0, 2.0):
        scene = Scene(pendulum / "pendulum.xml", poses, joint=0)
        scene.fit(aspect)
        a, e = np.radians([scene.camera.azimuth, scene.camera.elevation])
        forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([np.sin(a), -np.cos(a), 0.0])
        up = np.cross(right, forward)
        x = scene._corners - (np.asarray(scene.camera.lookat) - scene.camera.distance * forward)
        half = np.tan(np.radians(scene.model.vis.global_.fovy) / 2)
        reach = np.maximum(np.abs(x @ right) / aspect, np.abs(x @ up)) / (x @ forward) / half
        assert 0.7 < float(reach.max()) < 1.0


def test_geoms_in_hidden_groups_are_shown_when_nothing_else_moves(pendulum):
    (pendulum / "hidden.xml").write_text(PENDULUM.format(more="", group='group="3"'))
    scene = Scene(pendulum / "hidden.xml", ANGLE[:, None])
    assert scene.moves
    assert scene.option.geomgroup[3]


@pytest.mark.usefixtures("screen")
def test_a_ghost_is_drawn_where_the_recording_is(pendulum):
    """Only pixels near the second pose change, and with equal poses the ghost covers the model."""
    scene = Scene(pendulum / "pendulum.xml", np.array([[-0.8], [0.8]]), joint=0)
    scene.fit(4 / 3)
    other = mujoco.MjData(scene.model)
    with context.Offscreen(scene.model, 320, 240, scene.camera, scene.option) as drawn:
        alone = drawn.render(scene.pose(np.array([0.8]))).astype(float)
        both = drawn.render(scene.pose(np.array([0.8])), scene.pose(np.array([-0.8]), other), (213, 94, 0)).astype(float)
        changed = np.argwhere(np.abs(both - alone).sum(axis=2) > 30)
        first = drawn.render(scene.pose(np.array([-0.8]))).astype(float)
    assert len(changed) > 100
    moved = np.argwhere(np.abs(first - alone).sum(axis=2) > 60)
    low, high = moved.min(axis=0), moved.max(axis=0)
    assert (changed >= low - 3).all()
    assert (changed <= high + 3).all()
    orange = both[tuple(changed.T)]
    assert float(np.mean(orange[:, 0] - orange[:, 2])) > 40


@pytest.mark.usefixtures("screen")
@pytest.mark.parametrize(("style", "width"), [("ghost", 320), ("side", 640)])
def test_a_recording_in_a_picture_of_each_style(pendulum, style, width):
    out = pendulum / "two.png"
    words = [str(pendulum / "pendulum.xml"), "--recording", str(pendulum / "log.csv"), "--style", style, "--size", "320x240"]
    ended = CliRunner().invoke(command, [*words, "--out", str(out)])
    assert ended.exit_code == 0, ended.exception
    assert "own geoms" in ended.output
    assert iio.imread(out).shape[:2] == (240, width)


@pytest.mark.usefixtures("screen")
@pytest.mark.parametrize(
    "name", [pytest.param("arm.mp4", marks=pytest.mark.slow), pytest.param("arm.gif", marks=pytest.mark.slow), "arm.png"]
)
def test_a_robot_alone_in_each_format(arm, name, monkeypatch):
    monkeypatch.setattr("mjsim.robot.exciting.ROUNDS", 2)
    ended = CliRunner().invoke(
        command, [str(arm / "arm.xml"), "--out", str(arm / name), "--size", "160x120", "--fps", "4", "--duration", "1"]
    )
    assert ended.exit_code == 0, ended.exception
    assert (arm / name).stat().st_size > 1000


@pytest.mark.usefixtures("screen")
def test_a_model_without_a_moving_geom_is_drawn_as_the_magnified_axis(tmp_path):
    xml = """<mujoco><option gravity="0 0 0"/><worldbody><geom type="box" size=".1 .1 .1"/>
    <body name="b"><joint name="j" damping=".1"/><inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/></body></worldbody>
    <actuator><motor joint="j"/></actuator></mujoco>"""
    (tmp_path / "bare.xml").write_text(xml)
    words = [str(tmp_path / "bare.xml"), "--out", str(tmp_path / "bare.png"), "--size", "160x120"]
    ended = CliRunner().invoke(command, words)
    assert ended.exit_code == 0, ended.exception
    assert "magnified" in ended.output
    ended = CliRunner().invoke(command, [*words, "--view", "model"])
    assert "own geoms" in ended.output


def test_the_moment_of_a_still_is_that_of_the_largest_difference():
    pose = np.zeros((N, 1))
    other = pose.copy()
    other[123] = 1.0
    takes = [Take("a", TIME, pose, ()), Take("b", TIME, other, ())]
    grid = {"fps": 25.0, "speed": 1.0, "duration": None, "still": True}
    at, first, last = moments(takes, start=None, **grid)
    assert at[0] == pytest.approx(TIME[123], abs=DT)
    assert (first, last) == (0.0, TIME[-1])
    with pytest.raises(InputError, match="between 0 and"):
        moments(takes, start=5.0, **grid)


def test_magnified_motion_is_about_the_first_pose(pendulum, tmp_path):
    model = Rig.of(pendulum / "pendulum.xml").model
    take = Take("a", TIME, 1.0 + ANGLE[:, None], ())
    np.testing.assert_allclose(magnified(model, take, 3.0).qpos[:, 0], 1.0 + 3 * ANGLE)
    free = mujoco.MjModel.from_xml_string("<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>")
    with pytest.raises(InputError, match="free or ball joint"):
        magnified(free, Take("a", TIME, np.zeros((N, 7)), ()), 2.0)


def test_a_film_without_a_library_leaves_nothing(pendulum, monkeypatch):
    monkeypatch.setattr(context.ctypes.util, "find_library", lambda name: None)
    scene = Scene(pendulum / "pendulum.xml", ANGLE[:, None])
    with pytest.raises(InputError, match="apt-get install"):
        film_takes(scene, [Take("a", TIME, ANGLE[:, None], ())], pendulum / "film.png", Style.GHOST)
    assert not (pendulum / "film.png").exists()


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--recording", "nosuch.csv"], "no such file"),
        (["--simulation", "log.csv"], "--recording LOG"),
        (["--camera", "eye"], "no such camera"),
        (["--joint", "knee"], "no such joint"),
        (["--out", "pendulum.xml"], "mp4"),
    ],
)
def test_bad_input(pendulum, monkeypatch, words, match):
    monkeypatch.chdir(pendulum)
    given = [] if "--out" in words else ["--out", "film.png"]
    ended = CliRunner().invoke(command, ["pendulum.xml", *words, *given])
    assert isinstance(ended.exception, InputError)
    assert match in str(ended.exception)


def test_a_robot_log_without_a_common_time(arm):
    (arm / "bad.csv").write_text("time_s,elbow.angle_rad\n" + "\n".join(f"{t},{t}" for t in (0, 1, 2, 9, 10)) + "\n")
    with pytest.raises(InputError, match="not uniform"):
        recorded(Rig.of(arm / "arm.xml"), arm / "bad.csv")


@pytest.mark.slow
def test_a_robots_scenario_and_a_robot_itself_are_filmed_in_motion(tmp_path: Path, screen: None) -> None:
    for source in ("arm3_nominal", "arm3"):
        out = tmp_path / f"{source}.gif"
        words = [source, "--out", str(out), "--duration", "2", "--fps", "1", "--size", "320x240"]
        result = CliRunner().invoke(command, words, catch_exceptions=False)
        assert result.output.strip() == f"{out}: the model's own geoms"
        frames = iio.imread(out)[..., :3].astype(int)
        assert len(frames) == 3
        assert np.mean(np.abs(frames[-1] - frames[0])) > 1.0


def test_the_film_of_a_torque_log_runs_all_joints_as_replay_does(tmp_path: Path) -> None:
    """Torques alone would let the arm fall: held to the recording it stays beside it."""
    from mjsim.models import shipped_model
    from mjsim.robot.scenario import robot_scenario, run_robot, write_robot_log

    log = run_robot(robot_scenario("arm6_friction", duration_s=4.0))
    path, _ = write_robot_log(log, tmp_path)
    rig = Rig.of(shipped_model("arm6"))
    takes = simulated(rig, path), recorded(rig, path)
    assert 1e-3 < np.max(np.abs(takes[0].qpos - takes[1].qpos)) < 0.1
