"""Logs of a robot of three joints, written by the libraries of the formats' own makers."""

from __future__ import annotations

import numpy as np
import pytest

N, DT = 300, 0.01
T = DT * np.arange(N)
JOINTS = ("joint1", "joint2", "joint3")
ANGLE = np.column_stack([0.3 * np.sin(2 * np.pi * (k + 1) * T / T[-1]) for k in range(3)])
VELOCITY = np.gradient(ANGLE, DT, axis=0)
EFFORT = 2.0 * VELOCITY + 0.5
STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def joint_message(i, *, stamp, effort=True):
    ns = round((100.0 + T[i]) * 1e9) if stamp else 0
    header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": ""}
    return {
        "header": header, "name": list(JOINTS), "position": ANGLE[i].tolist(), "velocity": VELOCITY[i].tolist(),
        "effort": EFFORT[i].tolist() if effort else [],
    }  # fmt: skip


def logged(i, late=0.0):
    return round((200.0 + T[i] + late) * 1e9)


def write_mcap(path, *, stamp=True, command=False, gripper=False):
    writer = pytest.importorskip("mcap_ros2.writer")
    with path.open("wb") as handle:
        log = writer.Writer(handle)
        schema = log.register_msgdef("sensor_msgs/msg/JointState", STATE)
        for i in range(N):
            if command and i % 2 == 0:
                wanted = joint_message(i, stamp=stamp, effort=False) | {"velocity": []}
                log.write_message("/joint_commands", schema, wanted, logged(i))
            message = joint_message(i, stamp=stamp)
            if gripper:
                message["name"] = [*JOINTS, "gripper"]
                message |= {k: [*message[k], 0.1] for k in ("position", "velocity", "effort")}
            log.write_message("/joint_states", schema, message, logged(i))
        log.finish()


def ros_messages(store, ros1):
    """JointState objects of a rosbags typestore."""
    types = store.types
    kind, header, time = (types[f"{p}/msg/{n}"] for p, n in (
        ("sensor_msgs", "JointState"), ("std_msgs", "Header"), ("builtin_interfaces", "Time"))
    )  # fmt: skip
    for i in range(N):
        ns = round((100.0 + T[i]) * 1e9)
        parts = {"stamp": time(sec=ns // 10**9, nanosec=ns % 10**9), "frame_id": ""} | ({"seq": i} if ros1 else {})
        yield kind(header=header(**parts), name=list(JOINTS), position=ANGLE[i], velocity=VELOCITY[i], effort=EFFORT[i])


def write_bag(path):
    bag, types = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS1_NOETIC)
    with bag.Writer(path) as log:
        topic = log.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for i, message in enumerate(ros_messages(store, True)):
            log.write(topic, logged(i), store.serialize_ros1(message, "sensor_msgs/msg/JointState"))


def write_rosbag2(folder):
    bag, types = pytest.importorskip("rosbags.rosbag2"), pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS2_HUMBLE)
    with bag.Writer(folder, version=9) as log:
        topic = log.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for i, message in enumerate(ros_messages(store, False)):
            log.write(topic, logged(i), store.serialize_cdr(message, "sensor_msgs/msg/JointState"))
