"""Formats of robots' logs, written by the libraries of their own makers, and read without a binding."""

from __future__ import annotations

import json

import numpy as np
import pytest
from robot_logs import ANGLE, DT, EFFORT, JOINTS, VELOCITY, N, T, write_bag, write_mcap, write_rosbag2

import simgap
from mjsim.errors import InputError
from mjsim.readers import digest, read_table
from mjsim.readers.headers import guess


def check_states(table):
    np.testing.assert_allclose(table["time_s"], T, atol=1e-9)
    for k, joint in enumerate(JOINTS):
        np.testing.assert_allclose(table[f"{joint}.angle_rad"], ANGLE[:, k], atol=1e-12)
        np.testing.assert_allclose(table[f"{joint}.velocity_rad_s"], VELOCITY[:, k], atol=1e-12)
        np.testing.assert_allclose(table[f"{joint}.torque_Nm"], EFFORT[:, k], atol=1e-12)


@pytest.mark.parametrize("stamp", [True, False])
def test_mcap_of_ros_2(tmp_path, stamp):
    write_mcap(tmp_path / "log.mcap", stamp=stamp)
    table = read_table(tmp_path / "log.mcap")
    check_states(table)
    assert ("stamps of the messages" if stamp else "stamps of the log") in table.notes[0]


def test_a_ros_1_bag(tmp_path):
    write_bag(tmp_path / "log.bag")
    check_states(read_table(tmp_path / "log.bag"))


def test_rosbag2_as_a_folder_and_as_a_file(tmp_path):
    write_rosbag2(tmp_path / "log")
    check_states(read_table(tmp_path / "log"))
    (file,) = (tmp_path / "log").glob("*.db3")
    check_states(read_table(file))


def json_message(i, form):
    """One message of the state of all joints, and its stamp [ns]."""
    stamp = round((100.0 + T[i]) * 1e9)
    rows = [(j, dict(zip(("position", "velocity", "effort"), (ANGLE[i, k], VELOCITY[i, k], EFFORT[i, k]), strict=True)))
            for k, j in enumerate(JOINTS)]  # fmt: skip
    if form == "foxglove":
        return {"timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9}, "joints": [{"name": j} | v for j, v in rows]}
    lists = {key: [values[key] for _, values in rows] for key in ("position", "velocity", "effort")}
    return {"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}, "name": list(JOINTS), **lists}


def write_json_mcap(path, form, *, more=()):
    """JointState as ROS has it, or Foxglove's JointStates; ``more``: (topic, encoding, data) of messages beside each."""
    writing = pytest.importorskip("mcap.writer")
    with path.open("wb") as handle:
        writer = writing.Writer(handle)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {
            topic: writer.register_channel(topic, encoding, schema) for topic, encoding, _ in (("/state", "json", b""), *more)
        }
        for i in range(N):
            data = json.dumps(json_message(i, form)).encode()
            for topic, content in (("/state", data), *((topic, content) for topic, _, content in more)):
                writer.add_message(channels[topic], round((200.0 + T[i]) * 1e9), content, round((200.0 + T[i]) * 1e9))
        writer.finish()


@pytest.mark.parametrize("form", ["ros", "foxglove"])
def test_mcap_with_the_state_of_joints_in_json(tmp_path, form):
    write_json_mcap(tmp_path / "log.mcap", form, more=[("/camera", "flatbuffer", b"x"), ("/battery", "json", b'{"volt": 24}')])
    table = read_table(tmp_path / "log.mcap")
    check_states(table)
    assert "stamps of the messages" in table.notes[0]
    assert any("'camera' (messages encoded as 'flatbuffer')" in note for note in table.notes)
    np.testing.assert_array_equal(table["battery.volt"], 24.0)
    assert simgap.load(tmp_path / "log.mcap", model="arm3").joints == JOINTS


def test_mcap_with_commands_in_json(tmp_path):
    wanted = {"joint_names": list(JOINTS), "points": [{"positions": [0.1, 0.2, 0.3]}]}
    target = {"name": list(JOINTS), "position": [0.1, 0.2, 0.3], "velocity": [], "effort": []}
    for topic, message in (("/trajectory", wanted), ("/joint_targets", target)):
        path = tmp_path / f"{topic[1:]}.mcap"
        write_json_mcap(path, "ros", more=[(topic, "json", json.dumps(message).encode())])
        np.testing.assert_array_equal(read_table(path)[f"{JOINTS[1]}.command_rad"], 0.2)


def joint_states_schema():
    """Foxglove's JointStates as Protobuf: its message class and the descriptors that a log brings."""
    pytest.importorskip("mcap_protobuf")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    field = descriptor_pb2.FieldDescriptorProto
    one, many = field.LABEL_OPTIONAL, field.LABEL_REPEATED
    file = descriptor_pb2.FileDescriptorProto(name="joints.proto", package="foxglove", syntax="proto3")
    stamp = file.message_type.add(name="Stamp")
    stamp.field.add(name="seconds", number=1, type=field.TYPE_INT64, label=one)
    stamp.field.add(name="nanos", number=2, type=field.TYPE_INT32, label=one)
    joint = file.message_type.add(name="JointState")
    joint.field.add(name="name", number=1, type=field.TYPE_STRING, label=one)
    for i, key in enumerate(("position", "velocity", "acceleration", "effort")):
        joint.oneof_decl.add(name=f"_{key}")
        joint.field.add(name=key, number=i + 2, type=field.TYPE_DOUBLE, label=one, oneof_index=i, proto3_optional=True)
    all_joints = file.message_type.add(name="JointStates")
    all_joints.field.add(name="timestamp", number=1, type=field.TYPE_MESSAGE, label=one, type_name=".foxglove.Stamp")
    all_joints.field.add(name="joints", number=2, type=field.TYPE_MESSAGE, label=many, type_name=".foxglove.JointState")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.JointStates"))
    return kind, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


def test_mcap_with_the_state_of_joints_in_protobuf(tmp_path):
    kind, schema = joint_states_schema()
    writing = pytest.importorskip("mcap.writer")
    with (tmp_path / "log.mcap").open("wb") as handle:
        writer = writing.Writer(handle)
        writer.start()
        channel = writer.register_channel(
            "/state", "protobuf", writer.register_schema("foxglove.JointStates", "protobuf", schema)
        )
        for i in range(N):
            told = json_message(i, "foxglove")
            at = told["timestamp"]
            data = kind(timestamp={"seconds": at["sec"], "nanos": at["nsec"]}, joints=told["joints"]).SerializeToString()
            writer.add_message(channel, round((200.0 + T[i]) * 1e9), data, 0)
        writer.finish()
    table = read_table(tmp_path / "log.mcap")
    check_states(table)
    assert "stamps of the messages" in table.notes[0]


def test_commands_are_held_at_the_stamps_of_the_state(tmp_path):
    write_mcap(tmp_path / "log.mcap", command=True)
    table = read_table(tmp_path / "log.mcap")
    held = ANGLE[2 * (np.arange(N) // 2), 0]
    np.testing.assert_allclose(table["joint1.command_rad"], held, atol=1e-12)
    assert any("Commands are held" in note for note in table.notes)


def test_a_robot_takes_its_joints_from_a_log_without_a_binding(tmp_path):
    write_mcap(tmp_path / "log.mcap", gripper=True)
    log = simgap.load(tmp_path / "log.mcap", model="arm3")
    assert log.joints == JOINTS
    assert any("left out: gripper" in note for note in log.notes)
    np.testing.assert_allclose(log.torque, EFFORT, atol=1e-12)


def lerobot(folder, version, *, degrees=False, episodes=2):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    names = [f"{j}.pos" for j in JOINTS]
    feature = {"dtype": "float32", "shape": [3], "names": names if version == 2 else {"motors": names}}
    info = {
        "codebase_version": f"v{version}.0", "fps": 100, "total_episodes": episodes, "chunks_size": 1000,
        "features": {"action": feature, "observation.state": feature},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet" if version == 2
        else "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    }  # fmt: skip
    factor = 180 / np.pi if degrees else 1.0
    rows = [
        {"action": factor * (e + ANGLE), "observation.state": factor * (e + ANGLE - 0.01), "frame_index": np.arange(N),
         "episode_index": np.full(N, e)} for e in range(episodes)
    ]  # fmt: skip
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")

    def table(parts):
        joined = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
        return arrow.table({k: list(v.astype(np.float32)) if v.ndim == 2 else v for k, v in joined.items()})

    if version == 2:
        for e, part in enumerate(rows):
            parquet.write_table(table([part]), data / f"episode_{e:06d}.parquet")
    else:
        parquet.write_table(table(rows), data / "file-000.parquet")
        where = folder / "meta" / "episodes" / "chunk-000"
        where.mkdir(parents=True)
        index = {"episode_index": list(range(episodes)), "data/chunk_index": [0] * episodes, "data/file_index": [0] * episodes}
        parquet.write_table(arrow.table(index), where / "file-000.parquet")


@pytest.mark.parametrize("version", [2, 3])
def test_an_episode_of_a_lerobot_data_set(tmp_path, version):
    lerobot(tmp_path / "set", version)
    with pytest.raises(InputError, match=r"holds 2 episodes.*set#0 to "):
        read_table(tmp_path / "set")
    table = read_table(tmp_path / "set#1")
    np.testing.assert_allclose(table["time_s"], T)
    np.testing.assert_allclose(table["joint2.command_rad"], 1 + ANGLE[:, 1], atol=1e-6)
    np.testing.assert_allclose(table["joint2.angle_rad"], 0.99 + ANGLE[:, 1], atol=1e-6)
    assert any("taken as radians" in note for note in table.notes)
    assert digest(tmp_path / "set#0") != digest(tmp_path / "set#1")
    with pytest.raises(InputError, match="no episode 7"):
        read_table(tmp_path / "set#7")


def test_values_beyond_radians_keep_their_names(tmp_path):
    lerobot(tmp_path / "set", 2, degrees=True, episodes=1)
    table = read_table(tmp_path / "set")
    assert "observation.state.joint1" in table
    assert "joint1.angle_rad" not in table
    bound = {"joints": {"joint1": {"angle": {"column": "observation.state.joint1", "unit": "deg"}}}}
    with pytest.raises(InputError, match="no torque channel"):
        simgap.load(tmp_path / "set", binding=bound)
    with pytest.raises(
        InputError, match=r'write in set.toml, \[joints.joint1\] command = \{ column = "action.joint1", unit = "deg"'
    ):
        simgap.load(tmp_path / "set")


def test_a_data_set_does_not_lead_outside_its_folder(tmp_path):
    lerobot(tmp_path / "set", 2, episodes=1)
    info = tmp_path / "set" / "meta" / "info.json"
    told = json.loads(info.read_text())
    info.write_text(json.dumps(told | {"data_path": "../../{episode_chunk}{episode_index}.parquet"}))
    with pytest.raises(InputError, match="leaves the data set"):
        read_table(tmp_path / "set")


def test_the_form_of_sage(tmp_path):
    (tmp_path / "joint_list.txt").write_text("joint1\njoint2\njoint3\n")

    def rows(kind, header, *matrices):
        lines = [header]
        for i in range(N):
            cells = ",".join('"[' + ", ".join(f"{v:.9g}" for v in m[i]) + ']"' for m in matrices)
            lines.append(f"{kind},{T[i] * 1e6:.9g},{cells}")
        return "\n".join(lines) + "\n"

    (tmp_path / "state_motor.csv").write_text(rows("S", "type,timestamp,positions,velocities,torques", ANGLE, VELOCITY, EFFORT))
    (tmp_path / "control.csv").write_text(rows("C", "type,timestamp,positions", ANGLE + 0.1))
    table = read_table(tmp_path)
    np.testing.assert_allclose(table["time_s"], T, atol=1e-8)
    np.testing.assert_allclose(table["joint3.command_rad"], ANGLE[:, 2] + 0.1, atol=1e-8)
    np.testing.assert_allclose(table["joint3.torques"], EFFORT[:, 2], atol=1e-6)
    log = simgap.load(tmp_path, joint="joint1")
    np.testing.assert_allclose(log.command, ANGLE[:, 0] + 0.1, atol=1e-8)


def test_the_published_log_of_the_so101(local_copy):
    at = local_copy("so101", "raw/friction_gravity/state_motor.csv").parent
    table = read_table(at)
    assert table.shapes["Pitch.command_rad"] == table.shapes["Jaw.angle_rad"]
    assert "Pitch.velocity_rad_s" in table


@pytest.mark.parametrize("named", [True, False])
def test_an_archive_of_dof_positions(tmp_path, named):
    names = {"joint_names": np.array(JOINTS)} if named else {}
    np.savez(tmp_path / "log.npz", time=T, dof_pos=ANGLE, des_dof_pos=ANGLE + 0.1, **names)
    table = read_table(tmp_path / "log.npz")
    np.testing.assert_array_equal(table["joint2.angle_rad" if named else "dof_pos.1"], ANGLE[:, 1])
    np.testing.assert_array_equal(table["joint2.command_rad" if named else "des_dof_pos.1"], ANGLE[:, 1] + 0.1)
    if not named:
        with pytest.raises(InputError, match=r'names no joints: add the member joint_names, or bind each.*angle = "dof_pos.0"'):
            simgap.load(tmp_path / "log.npz")


def test_an_archive_of_one_joint_needs_no_name(tmp_path):
    np.savez(tmp_path / "log.npz", time=T, dof_pos=ANGLE[:, :1], des_dof_pos=ANGLE[:, :1] + 0.1)
    table = read_table(tmp_path / "log.npz")
    np.testing.assert_array_equal(table["angle_rad"], ANGLE[:, 0])
    np.testing.assert_array_equal(table["command_rad"], ANGLE[:, 0] + 0.1)


def test_matlab_7_3(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = T[None, :]
        group = file.create_group("rec")
        group["q"] = ANGLE[:, :1].T
        group["both"] = ANGLE[:, :2]  # MATLAB's 2 x N
    with path.open("r+b") as handle:
        handle.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    table = read_table(path)
    np.testing.assert_array_equal(table["rec.q"], ANGLE[:, 0])
    assert table.shapes["rec.both"] == (2, N)
    np.testing.assert_array_equal(table["rec.both"][1], ANGLE[:, 1])


@pytest.mark.parametrize(
    ("header", "by", "comma"),
    [("time_s;torque_Nm;velocity_rad_s", ";", True), ("time_s\ttorque_Nm\tvelocity_rad_s", "\t", False)],
)
def test_other_separators_are_taken_and_told(tmp_path, header, by, comma):
    lines = [by.join(f"{v:.9f}" for v in row) for row in zip(T, EFFORT[:, 0], VELOCITY[:, 0], strict=True)]
    body = "\n".join(lines)
    (tmp_path / "log.csv").write_text(f"{header}\n{body.replace('.', ',') if comma else body}\n")
    log = simgap.load(tmp_path / "log.csv")
    np.testing.assert_allclose(log.velocity, VELOCITY[:, 0], atol=1e-8)
    assert "Columns are separated by" in log.notes[0]
    assert ("decimals by commas" in log.notes[0]) is comma


def test_units_in_headers_are_guessed_and_told(tmp_path):
    table = np.column_stack([1e3 * T, EFFORT[:, 0], np.degrees(VELOCITY[:, 0]), np.degrees(ANGLE[:, 0])])
    header = "Time [ms],Motor torque (N m),speed [deg/s],angle_deg"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=header, comments="", fmt="%.12g")
    log = simgap.load(tmp_path / "log.csv")
    np.testing.assert_allclose(log.time, T, atol=1e-9)
    np.testing.assert_allclose(log.velocity, VELOCITY[:, 0], atol=1e-8)
    np.testing.assert_allclose(log.angle, ANGLE[:, 0], atol=1e-8)
    assert "guessed from their headers" in log.notes[0]


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        (["t [s]"], {"time": ("t [s]", "s")}),
        (["angle_deg", "angle [rad]"], {}),  # two of one channel
        (["torque [V]"], {}),  # a volt needs a gain
        (["speed [rpm]", "x"], {"velocity": ("speed [rpm]", "rpm")}),
        (["temperature [s]"], {}),
    ],
)
def test_what_a_header_says(headers, expected):
    assert guess(headers) == expected


def test_stamps_of_a_robot_are_resampled_where_that_is_asked_for(tmp_path):
    rng = np.random.default_rng(0)
    time = T + DT * np.r_[0, rng.uniform(-0.1, 0.1, N - 2), 0]
    columns = {"time_s": time}
    for k, joint in enumerate(JOINTS):
        columns[f"{joint}.angle_rad"] = np.interp(time, T, ANGLE[:, k])
        columns[f"{joint}.torque_Nm"] = EFFORT[:, k]
    with pytest.raises(InputError, match="uniform sampling"):
        simgap.load(columns, model="arm3")
    log = simgap.load(columns, model="arm3", binding={"recording": {"jitter": 0.3, "hold": "linear"}})
    np.testing.assert_allclose(np.diff(log.time), DT, rtol=1e-6)
    np.testing.assert_allclose(log.angle, ANGLE, atol=2e-3)
    assert "resampled" in log.notes[0]


@pytest.mark.parametrize("source", ["nothing.csv", "folder"])
def test_what_is_no_recording_is_told_with_the_forms_there_are(tmp_path, source):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="LeRobot"):
        simgap.load(tmp_path / source)
