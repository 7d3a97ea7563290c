"""Messages of a ROS log as columns: the state of joints, what they were commanded, and the numbers of all other topics.

``sensor_msgs/JointState`` gives ``JOINT.angle_rad``, ``JOINT.velocity_rad_s`` and ``JOINT.torque_Nm`` (ROS has radians and newton
metres on hinges, metres and newtons on slides: `Table.by_joint`). A JointState whose topic speaks of a command, a target or a
reference, a ``trajectory_msgs/JointTrajectory``, and the reference of a ``JointTrajectoryControllerState`` give
``JOINT.command_rad``. So do messages in JSON or Protobuf of the same form, and Foxglove's ``JointStates``.
Commands and other topics stand at the stamps of the state, each with its last value before (a zero-order hold).
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.table import Table, need_size

__all__ = ["Topics", "kind_of"]

COMMAND = re.compile(r"command|cmd|target|desired|reference|goal|setpoint|leader", re.IGNORECASE)
STATE_KIND, TRAJECTORY_KIND, CONTROLLER_KIND = "JointState", "JointTrajectory", "JointTrajectoryControllerState"
LIST_KIND = "JointStates"  # of Foxglove: a list with an entry a joint
CHANNELS = ("position", "velocity", "effort")
MOST_FIELDS = 256  # numbers of one message of any other kind: more are an image or a map
LEAST_PART = 0.5  # of the longest joint's samples: a joint with fewer is left out, since most of its values would be interpolated


@dataclass
class _Series:
    """Stamps [ns] by the sender's clock (0 where there is none) and by the log's, and values by field."""

    sent: array[int] = field(default_factory=lambda: array("q"))
    logged: array[int] = field(default_factory=lambda: array("q"))
    values: dict[str, array[float]] = field(default_factory=dict)

    def add(self, sent: int, logged: int, values: dict[str, float]) -> None:
        """One message; a field that it lacks is not a number."""
        for name in values:
            if name not in self.values:
                self.values[name] = array("d", [np.nan] * len(self.logged))
        self.sent.append(sent)
        self.logged.append(logged)
        for name, column in self.values.items():
            column.append(values.get(name, np.nan))

    def stamps(self, *, sender: bool) -> np.ndarray:
        """Stamps (N,) [ns]."""
        return np.frombuffer(self.sent if sender else self.logged, np.int64)

    def told(self, name: str) -> np.ndarray | None:
        """A field that at least one message fills with something other than zero, else None."""
        if name not in self.values:
            return None
        values = np.frombuffer(self.values[name], float)
        return values if np.isfinite(values).all() and np.any(values) else None


@final
class Topics:
    """Collects messages and makes a table of them."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._states: dict[str, dict[str, _Series]] = {}  # topic -> joint
        self._commands: dict[str, _Series] = {}  # joint
        self._others: dict[str, _Series] = {}
        self._left_out: dict[str, str] = {}
        self._bytes = 0

    def leave_out(self, topic: str, why: str) -> None:
        """Note a topic that is not read."""
        self._left_out[topic.strip("/")] = why

    @property
    def left_out(self) -> str:
        """The topics that are not read, and why, in one line."""
        return "; ".join(f"{name!r}: {why}" for name, why in self._left_out.items())

    def add(self, topic: str, kind: str, logged: int, message: Any) -> None:
        """One message of a topic; ``kind``: its type, as ``sensor_msgs/msg/JointState``; ``logged``: stamp of the log [ns]."""
        topic, kind = topic.strip("/"), kind.rpartition("/")[2]
        sent = _stamp(message)
        if kind in (STATE_KIND, LIST_KIND):
            self._joints(topic, sent, logged, message)
        elif kind == TRAJECTORY_KIND:
            points = _get(message, "points")
            if len(points):
                self._command(_get(message, "joint_names"), _get(points[0], "positions"), "position", sent, logged)
        elif kind == CONTROLLER_KIND:
            wanted = _get(message, "reference", None) or _get(message, "desired")
            self._command(_get(message, "joint_names"), _get(wanted, "positions"), "position", sent, logged)
        else:
            values: dict[str, float] = {}
            _flatten(message, "", values)
            if len(values) > MOST_FIELDS:
                self.leave_out(topic, f"more than {MOST_FIELDS} numbers in a message")
            else:
                self._grow(len(values))
                self._others.setdefault(topic, _Series()).add(sent, logged, values)

    def _joints(self, topic: str, sent: int, logged: int, message: Any) -> None:
        rows = _rows(message)
        if COMMAND.search(topic) is not None:
            for key in CHANNELS:
                told = {joint: values[key] for joint, values in rows if key in values}
                self._command(told.keys(), told.values(), key, sent, logged)
            return
        joints = self._states.setdefault(topic, {})
        for joint, values in rows:
            self._grow(len(values))
            joints.setdefault(joint, _Series()).add(sent, logged, values)

    def _command(self, names: Iterable[Any], values: Iterable[Any], kind: str, sent: int, logged: int) -> None:
        for joint, value in zip(names, values, strict=False):
            self._grow(1)
            series = self._commands.setdefault(str(joint), _Series())
            if kind != "position" and len(series.logged) and series.logged[-1] == logged:
                series.values.setdefault(kind, array("d", [np.nan] * len(series.logged)))[-1] = float(value)
            else:
                series.add(sent, logged, {kind: float(value)})

    def _grow(self, numbers: int) -> None:
        self._bytes += 8 * (numbers + 2)
        need_size(self._path, "the log", self._bytes)

    def table(self) -> Table:
        """The columns; see the module's text. Raises InputError for a log without a number."""
        if not self._states:
            return self._plain()
        topic = max(self._states, key=lambda t: max(len(s.logged) for s in self._states[t].values()))
        joints = self._states[topic]
        longest = max(joints.values(), key=lambda s: len(s.logged))
        sender = all(all(s.sent) for s in (*joints.values(), *self._commands.values()))
        base = longest.stamps(sender=sender)
        notes = [f"State from the topic {topic!r}, stamps of the {'messages' if sender else 'log'}."]
        columns: dict[str, np.ndarray] = {}
        for joint, series in joints.items():
            notes += self._state(columns, joint, series, base, sender=sender)
        begin = self._commanded(columns, base, notes, sender=sender)
        for name, other in self._others.items():
            at = other.stamps(sender=False)
            here = longest.stamps(sender=False)
            for key in other.values:
                columns[f"{name}.{key}"] = _held(at, np.frombuffer(other.values[key], float), here)
        notes += [f"Not read: topic {name!r} ({why})." for name, why in self._left_out.items()]
        columns = {"time_s": (base - base[begin]) * 1e-9, **columns}
        return Table.of({k: v[begin:] for k, v in columns.items()}, notes=tuple(notes), by_joint=True)

    def _state(self, columns: dict[str, np.ndarray], joint: str, series: _Series, base: np.ndarray, *, sender: bool) -> list[str]:
        """Enter the columns of one joint, at its own stamps or interpolated; what there is to say of it."""
        at = series.stamps(sender=sender)
        alike = len(at) == len(base) and bool(np.array_equal(at, base))
        if len(at) < LEAST_PART * len(base):
            return [f"Joint {joint!r} is left out: {len(at)} messages, others {len(base)}."]
        for key, role in (("position", "angle_rad"), ("velocity", "velocity_rad_s"), ("effort", "torque_Nm")):
            values = series.told(key)
            if values is None and key == "position":
                values = np.frombuffer(series.values.get("position", array("d")), float)
            if values is not None and len(values) == len(at):
                columns[f"{joint}.{role}"] = values if alike else np.interp(base, at, values)
        return [] if alike else [f"Joint {joint!r} has stamps of its own: interpolated onto those of the others."]

    def _commanded(self, columns: dict[str, np.ndarray], base: np.ndarray, notes: list[str], *, sender: bool) -> int:
        """Enter the commands, held, at the stamps of the state; the first sample at which all of them are known."""
        begin = 0
        for joint, series in self._commands.items():
            at = series.stamps(sender=sender)
            for key, role in (("position", "command_rad"), ("effort", "torque_Nm")):
                values = series.told(key)
                if values is None or f"{joint}.{role}" in columns:
                    continue
                columns[f"{joint}.{role}"] = _held(at, values, base)
                begin = max(begin, int(np.searchsorted(base, at[0])))
        if self._commands:
            notes.append("Commands are held from their own stamps on, at the stamps of the state.")
        if begin:
            notes.append(f"The first {begin} samples of the state come before the first command and are left out.")
        if begin >= len(base) - 1:
            raise InputError(self._path, "the commands come after the state", "both at the same time", "check the clocks")
        return begin

    def _plain(self) -> Table:
        """Topics without a state: ``topic.field``, with the short name where only one topic has it; ``log_time`` [s]."""
        table: dict[str, np.ndarray] = {}
        short: dict[str, list[np.ndarray]] = {}
        if not self._others:
            told = f" ({self.left_out})" if self._left_out else ""
            raise InputError(self._path, f"no topic with numbers{told}", "a log of a robot", "record one")
        first = min(s.logged[0] for s in self._others.values())
        longest = max(len(s.logged) for s in self._others.values())
        for topic, series in self._others.items():
            columns = {key: np.frombuffer(v, float) for key, v in series.values.items()}
            columns["log_time"] = (series.stamps(sender=False) - first) * 1e-9
            for name, values in columns.items():
                table[f"{topic}.{name}"] = values
                if len(values) == longest:
                    short.setdefault(name, []).append(values)
        table.update({name: arrays[0] for name, arrays in short.items() if len(arrays) == 1 or name == "log_time"})
        return Table.of(table)


def _held(at: np.ndarray, values: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Values at stamps ``base``, each the last one before; not a number ahead of the first."""
    index = np.searchsorted(at, base, side="right") - 1
    out = np.asarray(values[np.maximum(index, 0)], float)
    out[index < 0] = np.nan
    return out


def kind_of(message: Any) -> str:
    """The type of a message that is a mapping without a type, by its keys; empty for any that holds no state or command."""
    if not isinstance(message, Mapping):
        return ""
    joints, names, keys = message.get("joints"), message.get("name"), message.keys()
    if isinstance(joints, list) and joints and all(isinstance(j, Mapping) and isinstance(j.get("name"), str) for j in joints):
        return LIST_KIND
    if isinstance(names, list) and names and all(isinstance(n, str) for n in names) and keys & set(CHANNELS):
        return STATE_KIND
    if isinstance(message.get("joint_names"), list):
        return TRAJECTORY_KIND if "points" in keys else CONTROLLER_KIND if keys & {"reference", "desired"} else ""
    return ""


_NEEDED = object()


def _get(message: Any, name: str, missing: Any = _NEEDED) -> Any:
    """A field of a message, which is a mapping or an object; ``missing``: what stands for one that is not there."""
    if isinstance(message, Mapping):
        return message[name] if missing is _NEEDED else message.get(name, missing)
    return getattr(message, name) if missing is _NEEDED else getattr(message, name, missing)


def _rows(message: Any) -> list[tuple[str, dict[str, float]]]:
    """(joint, its numbers) of a JointState, whose lists may be empty, and of Foxglove's JointStates."""
    listed = _get(message, "joints", None)
    if listed is not None:
        told = [(str(_get(j, "name")), {key: _get(j, key, None) for key in CHANNELS}) for j in listed]
        return [(name, {key: float(v) for key, v in values.items() if v is not None}) for name, values in told]
    names = _get(message, "name")
    columns = {key: _get(message, key, ()) for key in CHANNELS}
    full = {key: values for key, values in columns.items() if len(values) == len(names)}
    return [(str(name), {key: float(values[i]) for key, values in full.items()}) for i, name in enumerate(names)]


def _stamp(message: Any) -> int:
    """Stamp [ns] of the message's header, or of its own (Foxglove); 0 where it has none."""
    stamp = _get(_get(message, "header", None), "stamp", None) or _get(message, "timestamp", None)
    seconds, parts = (next((v for k in keys if isinstance(v := _get(stamp, k, None), int)), 0) for keys in _STAMP)
    return int(seconds) * 1_000_000_000 + int(parts)


_STAMP = (("sec", "secs", "seconds"), ("nanosec", "nsecs", "nsec", "nanos"))  # of ROS 2, ROS 1, Foxglove, Protobuf


def _flatten(value: Any, name: str, out: dict[str, float], depth: int = 0) -> None:
    """Numbers of a message by their dotted names, at most a few more than `MOST_FIELDS`."""
    if len(out) > MOST_FIELDS or depth > 8 or isinstance(value, str | bytes):
        return
    if isinstance(value, bool | int | float | np.generic):
        if not isinstance(value, np.generic) or value.dtype.kind in "fiub":
            out[name or "data"] = float(value)
    elif isinstance(value, list | tuple | np.ndarray):
        for i, item in enumerate(value[: MOST_FIELDS + 1]):
            _flatten(item, f"{name}.{i}" if name else str(i), out, depth + 1)
    else:
        names = value.keys() if isinstance(value, Mapping) else (
            getattr(value, "__dataclass_fields__", None) or getattr(value, "__slots__", None) or ()
        )  # fmt: skip
        for key in names:
            if key not in ("header", "layout") and not key.startswith("_"):
                _flatten(_get(value, key), f"{name}.{key}" if name else str(key), out, depth + 1)
