"""One log of a pendulum under a position servo in each format that has commands: `check` and `diagnose` give one answer."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from robot_logs import STATE

import simgap

DT, N = 0.01, 1200
T = DT * np.arange(N)
COMMAND = 0.6 * np.sin(2 * np.pi * 0.4 * T) + 0.3 * np.sin(2 * np.pi * 1.1 * T + 1)
FRICTION = 0.5


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """The pendulum with a servo in place of its motor."""
    spec = simgap.Model("pendulum").spec
    spec.actuator("torque").set_to_position(kp=20.0, kv=1.0)
    spec.compile()
    path = tmp_path_factory.mktemp("model") / "servo.xml"
    path.write_text(spec.to_xml())
    return path


@pytest.fixture(scope="module")
def angle(model):
    """The angle (N,) with friction that the model lacks, and noise."""
    friction = simgap.effects["coulomb_friction"](place="motor", torque_Nm=FRICTION)
    run = simgap.simulate(model, COMMAND, dt=DT, effects=[friction])
    return run.angle + 2e-4 * np.random.default_rng(0).standard_normal(N)


def stamps():
    return [10**9 + round(1e9 * t) for t in T]


def lerobot(folder, angle, version):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    feature = {"dtype": "float64", "shape": [1], "names": ["pendulum.pos"]}
    form = "episode_{episode_index:06d}" if version == 2 else "file-{file_index:03d}"
    info = {
        "codebase_version": f"v{version}.0", "fps": 100, "total_episodes": 1, "chunks_size": 1000,
        "features": {"action": feature, "observation.state": feature}, "data_path": f"data/{form}.parquet",
    }  # fmt: skip
    episodes = folder / "meta" / "episodes"
    for part in (episodes, folder / "data"):
        part.mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    columns = {"action": list(COMMAND[:, None]), "observation.state": list(angle[:, None])}
    columns |= {"frame_index": np.arange(N), "episode_index": np.zeros(N, int)}
    parquet.write_table(arrow.table(columns), folder / "data" / f"{'episode_000000' if version == 2 else 'file-000'}.parquet")
    if version == 3:
        where = {"episode_index": [0], "data/chunk_index": [0], "data/file_index": [0]}
        parquet.write_table(arrow.table(where), episodes / "file-000.parquet")
    return folder


def mcap(path, angle):
    writing = pytest.importorskip("mcap_ros2.writer")
    with path.open("wb") as handle:
        log = writing.Writer(handle)
        schema = log.register_msgdef("sensor_msgs/msg/JointState", STATE)
        for ns, *values in zip(stamps(), COMMAND, angle, strict=True):
            header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": ""}
            for topic, value in zip(("/joint_command", "/joint_states"), values, strict=True):
                message = {"header": header, "name": ["pendulum"], "position": [value], "velocity": [], "effort": []}
                log.write_message(topic, schema, message, ns)
        log.finish()
    return path


def ros(path, angle, version):
    bag, types = pytest.importorskip(f"rosbags.rosbag{version}"), pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS1_NOETIC if version == 1 else types.Stores.ROS2_HUMBLE)
    names = ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    kind, header, time = (store.types[name] for name in names)
    pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with bag.Writer(path) if version == 1 else bag.Writer(path, version=9) as log:
        topics = [log.add_connection(topic, names[0], typestore=store) for topic in ("/joint_command", "/joint_states")]
        for i, ns in enumerate(stamps()):
            parts = {"stamp": time(sec=ns // 10**9, nanosec=ns % 10**9), "frame_id": ""} | ({"seq": i} if version == 1 else {})
            for topic, value in zip(topics, (COMMAND[i], angle[i]), strict=True):
                none, position = np.empty(0), np.array([value])
                state = kind(header=header(**parts), name=["pendulum"], position=position, velocity=none, effort=none)
                log.write(topic, ns, pack(state, names[0]))
    return path


def sage(folder, angle):
    folder.mkdir()
    (folder / "joint_list.txt").write_text("pendulum\n")
    for name, values in (("state_motor", angle), ("control", COMMAND)):
        rows = (f'x,{round(1e6 * t)},"[{v!r}]"\n' for t, v in zip(T.tolist(), values.tolist(), strict=True))
        (folder / f"{name}.csv").write_text("type,timestamp,positions\n" + "".join(rows))
    return folder


def npz(path, angle):
    np.savez(path, time=T, des_dof_pos=COMMAND[:, None], dof_pos=angle[:, None])
    return path


def csv(path, angle):
    rows = zip(1e3 * T, np.degrees(COMMAND), np.degrees(angle), strict=True)
    lines = (f"{t:.0f};{c:.12f};{q:.12f}\n".replace(".", ",") for t, c, q in rows)
    path.write_text("time [ms];command [deg];angle [deg]\n" + "".join(lines))
    return path


FORMS = {
    "csv": lambda at, q: csv(at / "log.csv", q), "npz": lambda at, q: npz(at / "log.npz", q),
    "lerobot2": lambda at, q: lerobot(at / "set", q, 2), "lerobot3": lambda at, q: lerobot(at / "set", q, 3),
    "mcap": lambda at, q: mcap(at / "log.mcap", q), "rosbag2": lambda at, q: ros(at / "bag", q, 2),
    "rosbag1": lambda at, q: ros(at / "log.bag", q, 1), "sage": lambda at, q: sage(at / "sage", q),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_the_command_checks_a_log(tmp_path, run_cli, model, angle, form):
    log: Path = FORMS[form](tmp_path, angle)
    code, out, err = run_cli("check", str(log), "--model", str(model), "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["verdict"] == "ready"
    (numbers,) = found["measured"].values()
    assert numbers["sample_time_s"] == pytest.approx(DT)
    assert numbers["axis"]["angle over command"]["delay"] == pytest.approx(0.068, abs=0.001)


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_the_command_diagnoses_a_log(tmp_path, run_cli, model, angle, form):
    log: Path = FORMS[form](tmp_path, angle)
    words = ("--model", str(model), "--effects", "coulomb_friction,servo_deadband", "--out", str(tmp_path / "out"))
    code, _, err = run_cli("diagnose", str(log), *words)
    assert code == 0, err
    (finding,) = json.loads((tmp_path / "out" / "diagnosis.json").read_text())["findings"]
    low, high = finding["parameters"]["torque_Nm"]["ci95"]
    assert finding["effect"] == "coulomb_friction"
    assert low <= FRICTION <= high
