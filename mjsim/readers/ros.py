"""ROS bags: ROS 1 ``.bag``, and the SQLite form of rosbag2, ``.db3``.

Messages of the types that ROS itself defines are decoded by the definitions that come with the package ``rosbags``. Those that a
file brings are not used, since that package turns a definition into code.
"""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path
from typing import Any

from mjsim.readers.optional import need
from mjsim.readers.table import Table
from mjsim.readers.topics import Topics

__all__ = ["read_bag", "read_db3"]

NO_TYPE = "its type is not one of ROS's own"


def read_bag(path: Path) -> Table:
    """A ROS 1 bag, as `Topics` makes columns of it."""
    reader, types = need("rosbags.rosbag1", path), need("rosbags.typesys", path)
    known = types.get_typestore(types.Stores.ROS1_NOETIC)
    topics = Topics(path)
    with reader.Reader(path) as bag:
        chosen = _chosen(topics, known, [(c, c.topic, c.msgtype) for c in bag.connections])
        for connection, stamp, raw in bag.messages(connections=chosen) if chosen else ():
            topics.add(connection.topic, connection.msgtype, stamp, known.deserialize_ros1(raw, connection.msgtype))
    return topics.table()


def read_db3(path: Path) -> Table:
    """One SQLite file of a rosbag2 recording, as `Topics` makes columns of it; it is opened to be read only."""
    types = need("rosbags.typesys", path)
    known = types.get_typestore(types.Stores.ROS2_JAZZY)
    topics = Topics(path)
    place = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    with contextlib.closing(sqlite3.connect(place, uri=True)) as base:
        rows = base.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        for _, name, _, form in rows:
            if form != "cdr":
                topics.leave_out(name, f"messages encoded as {form!r}")
        chosen = {i: (name, kind) for i, name, kind in _chosen(
            topics, known, [((i, name, kind), name, kind) for i, name, kind, form in rows if form == "cdr"]
        )}  # fmt: skip
        for topic, stamp, raw in base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, rowid"):
            if topic in chosen:
                name, kind = chosen[topic]
                topics.add(name, kind, int(stamp), known.deserialize_cdr(raw, kind))
    return topics.table()


def _chosen(topics: Topics, known: Any, connections: list[tuple[Any, str, str]]) -> list[Any]:
    """Connections whose type is known; the others are noted."""
    out = []
    for connection, name, kind in connections:
        if kind in known.types:
            out.append(connection)
        else:
            topics.leave_out(name, NO_TYPE)
    return out
