"""MCAP logs with messages in JSON, or of ROS 2 (CDR with the definitions that the file brings)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.optional import need
from mjsim.readers.table import Table
from mjsim.readers.topics import Topics

__all__ = ["read_mcap"]


def read_mcap(path: Path) -> Table:
    """JSON messages: ``topic.field`` for each number; a column of all topics alike for fields that only one topic has.

    ``topic.log_time`` and ``log_time`` [s] count from the first message. Topics of another length than the longest are left out
    of the short names.
    """
    reader = need("mcap.reader", path)
    if _is_ros(reader, path):
        return _read_ros(reader, path)
    columns: dict[str, dict[str, list[float]]] = {}
    first: int | None = None
    with path.open("rb") as handle:
        for schema, channel, message in reader.make_reader(handle, validate_crcs=True).iter_messages():
            if channel.message_encoding != "json":
                kind = channel.message_encoding or (schema.encoding if schema else "")
                raise InputError(
                    path, f"topic {channel.topic!r} is encoded as {kind!r}", "messages in JSON or of ROS 2",
                    "convert it to JSON or CSV",
                )  # fmt: skip
            first = message.log_time if first is None else first
            values: dict[str, float] = {"log_time": (message.log_time - first) * 1e-9}
            _flatten(json.loads(message.data), "", values)
            topic = columns.setdefault(channel.topic.strip("/"), {})
            for name, value in values.items():
                topic.setdefault(name, []).append(value)
    return _merge(columns, path)


def _is_ros(reader: Any, path: Path) -> bool:
    """Whether the first message is one of ROS 2."""
    with path.open("rb") as handle:
        for _, channel, _ in reader.make_reader(handle, validate_crcs=True).iter_messages():
            return bool(channel.message_encoding == "cdr")
    return False


def _read_ros(reader: Any, path: Path) -> Table:
    """As `mjsim.readers.topics.Topics` makes columns of it; the definitions in the file are interpreted, not run."""
    factory = need("mcap_ros2.decoder", path).DecoderFactory()
    topics = Topics(path)
    with path.open("rb") as handle:
        for schema, channel, message in reader.make_reader(handle, validate_crcs=True).iter_messages():
            decode = factory.decoder_for(channel.message_encoding, schema)
            if decode is None:
                topics.leave_out(channel.topic, f"messages encoded as {channel.message_encoding!r}")
            else:
                topics.add(channel.topic, schema.name, message.log_time, decode(message.data))
    return topics.table()


def _flatten(value: Any, name: str, out: dict[str, float]) -> None:
    """Numbers of a JSON value by their dotted names."""
    if isinstance(value, dict):
        for key, item in value.items():
            _flatten(item, f"{name}.{key}" if name else str(key), out)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            _flatten(item, f"{name}.{i}" if name else str(i), out)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        out[name or "value"] = float(value)


def _merge(columns: dict[str, dict[str, list[float]]], path: Path) -> Table:
    """Long names for all fields; short names for those that one topic alone has."""
    table: dict[str, np.ndarray] = {}
    short: dict[str, list[np.ndarray]] = {}
    longest = max((len(c["log_time"]) for c in columns.values()), default=0)
    for topic, fields in columns.items():
        count = len(fields["log_time"])
        for name, values in fields.items():
            if len(values) != count:
                raise InputError(
                    path,
                    f"topic {topic!r}: {name!r} in {len(values)} of {count} messages",
                    "the same fields in all",
                    "split the topic",
                )
            array = np.array(values)
            table[f"{topic}.{name}"] = array
            if count == longest:
                short.setdefault(name, []).append(array)
    table.update({name: arrays[0] for name, arrays in short.items() if len(arrays) == 1 or name == "log_time"})
    return Table.of(table)
