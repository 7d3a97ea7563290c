"""Recordings of robots: columns by joint, bindings, and what is refused."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from lab.robot.arm import three_axes
from mjsim.errors import InputError
from mjsim.robot.binding import RobotBinding
from mjsim.robot.model import robot_from
from mjsim.robot.recording import joints_named, load_robot_recording


@pytest.fixture(scope="module")
def robot():
    return robot_from(mujoco.MjModel.from_xml_string(three_axes().mjcf("arm")))


@pytest.fixture
def log(tmp_path):
    """``log(**columns)``: a CSV of 300 samples at 100 Hz; a column that is None is left out."""
    t = 0.01 * np.arange(300)
    base = {"time_s": t}
    for k in (1, 2, 3):
        base |= {f"joint{k}.angle_rad": 0.3 * np.sin((1 + k) * t), f"joint{k}.torque_Nm": np.cos((1 + k) * t)}

    def write(name="log.csv", **columns):
        table = base | {n.replace("__", "."): c for n, c in columns.items()}
        table = {k: v for k, v in table.items() if v is not None}
        path = tmp_path / name
        np.savetxt(path, np.column_stack(list(table.values())), delimiter=",", header=",".join(table), comments="")
        return path

    return write


def test_columns_are_found_by_the_joints_names(log, robot):
    r = load_robot_recording(log(), robot)
    assert r.joints == ("joint1", "joint2", "joint3")
    assert r.angle.shape == r.torque.shape == (300, 3)
    assert r.command is None
    assert r.has("torque", "joint2")
    assert not r.angle.flags.writeable
    assert joints_named(log()) == ("joint1", "joint2", "joint3")


def test_a_joint_that_is_not_in_the_log_is_held(log, robot):
    r = load_robot_recording(log(joint2__angle_rad=None, joint2__torque_Nm=None), robot)
    assert r.joints == ("joint1", "joint3")
    assert r.held_at == (("joint2", 0.0),)
    assert np.all(r.positions(robot)[:, 1] == 0)


def test_a_binding_gives_columns_units_and_a_payload(log, robot):
    path = log(q=np.degrees(0.2 * np.sin(0.01 * np.arange(300))), u=np.ones(300))
    path.with_suffix(".toml").write_text(
        '[recording]\nhold = "mean"\ntime = "time_s"\n'
        '[joints.joint1]\nangle = {column = "q", unit = "deg"}\n'
        'torque = {column = "u", unit = "A", gain = 0.5}\n'
        '[experiment]\npayload = {body = "forearm", mass = 1.5, pos = [0, 0, 0.1]}\n'
    )
    r = load_robot_recording(path, robot)
    assert r.joints == ("joint1",)
    np.testing.assert_allclose(r.angle[:, 0], 0.2 * np.sin(0.01 * np.arange(300)), atol=1e-12)
    assert r.torque[0, 0] == 0.5
    assert r.hold == "mean"
    assert r.payload.mass == 1.5


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        ("[experiment]\nsuply_V = 12", "did you mean 'supply_V'"),
        ("[experiment]\npaylod = {body = 'forearm', mass = 1}", "did you mean 'payload'"),
        ('[recording]\ntim = "time_s"', "did you mean 'time'"),
        ('[joints.joint1]\nangel = "q"', "did you mean 'angle'"),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest_name(log, robot, toml, said):
    path = log()
    path.with_suffix(".toml").write_text(toml)
    with pytest.raises(InputError, match=said):
        load_robot_recording(path, robot)


def test_a_known_value_that_no_fit_of_a_robot_uses_is_named(log, robot):
    path = log()
    path.with_suffix(".toml").write_text("[experiment]\nkp = 3\nsupply_V = 12\n")
    assert any("kp, supply_V: not used" in note for note in load_robot_recording(path, robot).notes)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (
            {"join2__angle_rad": np.zeros(300)},
            "joint 'join2' is not in the model; expected one of joint1, joint2, joint3; did you mean 'joint2'",
        ),
        ({"joint2__angle_rad": None}, "joint 'joint2' has no position"),
        ({"joint2__angle_m": np.zeros(300)}, "expected joint2.angle_rad"),
        ({"joint2__angle_rad": np.linspace(0, 5, 300)}, "joint2 is at .* the joint's range"),
        ({"joint1__torque_Nm": np.full(300, np.nan)}, "row 2"),
        ({"time_s": np.concatenate([[0, 0.02], 0.01 * np.arange(3, 301)])}, "sample time"),
    ],
)
def test_bad_logs_are_refused_in_one_line(log, robot, columns, said):
    with pytest.raises(InputError, match=said) as error:
        load_robot_recording(log(**columns), robot)
    assert "\n" not in str(error.value)


def test_commands_of_joints_that_are_swapped_are_found(log, robot):
    t = 0.01 * np.arange(300)
    commands = {f"joint{k}__command_rad": 0.3 * np.sin((1 + k) * t) for k in (1, 2, 3)}
    assert load_robot_recording(log(**commands), robot).command is not None
    one, two = commands["joint1__command_rad"], commands["joint2__command_rad"]
    with pytest.raises(InputError, match="command of joint1 goes with the position of joint2"):
        load_robot_recording(log(**commands | {"joint1__command_rad": two, "joint2__command_rad": one}), robot)


@pytest.mark.parametrize("name", ["recording", "experiment", "joints"])
@pytest.mark.parametrize("value", ["3", "[{time = 1}]"])
def test_a_value_in_place_of_a_table_is_refused(tmp_path, name, value):
    path = tmp_path / "log.toml"
    path.write_text(f"{name} = {value}\n")
    with pytest.raises(InputError, match=rf"a table \[{name}\]"):
        RobotBinding.from_toml(path)
