"""Which column is which channel of which joint: ``[recording]``, ``[joints.NAME]`` and ``[experiment]`` of a TOML file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjsim.binding import OWN_KEYS, Binding, Channel
from mjsim.errors import InputError, nearest
from mjsim.experiment_table import (
    CHANNEL_KEYS,
    need_known,
    need_known_experiment,
    need_no_misspelt_table,
    need_no_model_table,
    table_of,
)
from mjsim.hold import HOLDS
from mjsim.readers import part_of
from mjsim.timebase import LARGEST
from mjsim.toml import lies_at, toml_at

__all__ = ["CHANNELS", "MEASURES", "Payload", "RobotBinding", "find_robot_binding"]

CHANNELS = ("command", "torque", "angle", "velocity", "current", "second_angle")
MEASURES = dict(zip(CHANNELS, ("angle", "torque", "angle", "velocity", "current", "angle"), strict=True))


@dataclass(frozen=True)
class Payload:
    """A known point mass [kg] at ``pos`` [m] in the frame of a body, mounted in one recording."""

    body: str
    mass: float
    pos: tuple[float, float, float]


@dataclass(frozen=True)
class RobotBinding:
    """joints: by joint and channel (column, factor to SI, row of a matrix or None); time: (column, factor), or dt [s].

    jitter: stamps may be off by this part of the sample time, and are resampled uniformly.
    unused: keys of ``[experiment]`` that a robot's diagnosis does not use; hold_stated: whether the file states the hold.
    """

    joints: dict[str, dict[str, tuple[str, float, int | None]]]
    time: tuple[str, float] | None
    dt: float | None
    hold: str
    payload: Payload | None
    source: str
    jitter: float = 0.0
    unused: tuple[str, ...] = ()
    hold_stated: bool = False

    @classmethod
    def from_toml(cls, path: Path) -> RobotBinding | None:
        """The binding that a file states; None when it says nothing of a robot (joints, hold, experiment). Raises InputError
        for a key that is not known."""
        table = toml_at(path)
        need_no_model_table(table, path)
        return cls.from_tables(table, path)

    @classmethod
    def from_tables(cls, table: Mapping[str, Any], path: Path) -> RobotBinding | None:
        """The binding that the tables of a TOML file state; ``path``: how messages name it. Raises InputError."""
        need_no_misspelt_table(table, path)
        recording, experiment = table_of(table, "recording", path), table_of(table, "experiment", path)
        need_known(recording, (*Binding.CHANNELS, *OWN_KEYS), f"{path}: [recording]")
        need_known_experiment(experiment, path)
        if (
            "joints" not in table
            and not {"hold", "jitter"} & set(recording)
            and not {"payload", *Binding.KNOWN} & set(experiment)
        ):
            return None
        if "input" in recording and "joints" in table:
            raise InputError(
                f"{path}: [recording] input", "it is used of one joint only", "a robot whose drives were on", "remove the key"
            )
        joints: dict[str, dict[str, tuple[str, float, int | None]]] = {}
        for name, channels in table_of(table, "joints", path).items():
            where = f"{path}: [joints.{name}]"
            if not isinstance(channels, dict):
                raise InputError(where, "no table", "command, torque, angle, ...", "correct it")
            need_known(channels, CHANNELS, where)
            for key, value in channels.items():
                joints.setdefault(name, {})[key] = _bound(value, MEASURES[key], f"{where} {key}")
        hold = recording.get("hold", "held")
        if hold not in HOLDS:
            raise InputError(
                f"{path}: [recording] hold", f"{hold!r}", " or ".join(HOLDS), nearest(str(hold), HOLDS, "correct it")
            )
        dt = recording.get("dt")
        if dt is not None and not (isinstance(dt, int | float) and 0 < dt < math.inf):
            raise InputError(f"{path}: [recording] dt", f"{dt!r}", "a sample time in seconds, above zero", "correct it")
        time = _bound(recording["time"], "time", f"{path}: [recording] time")[:2] if "time" in recording else None
        payload = _payload(experiment.get("payload"), f"{path}: [experiment] payload")
        jitter = recording.get("jitter", 0.0)
        if not (isinstance(jitter, int | float) and not isinstance(jitter, bool) and 0 <= jitter < math.inf):
            raise InputError(f"{path}: [recording] jitter", f"{jitter!r}", "a part of the sample time, above zero", "correct it")
        unused = tuple(key for key in experiment if key != "payload")
        return cls(joints, time, dt, hold, payload, str(path), float(jitter), unused, "hold" in recording)


def _bound(value: Any, measures: str, where: str) -> tuple[str, float, int | None]:
    """(column, factor, row) of a column name or a table {column, unit, gain, row}."""
    if isinstance(value, str):
        return value, 1.0, None
    if not isinstance(value, dict) or not isinstance(value.get("column"), str):
        need_known(value if isinstance(value, dict) else (), CHANNEL_KEYS, where)
        raise InputError(where, "no column named", '"name" or {column = "name", unit = ...}', "add it")
    need_known(value, CHANNEL_KEYS, where)
    row, gain = value.get("row"), value.get("gain")
    if not (row is None or (isinstance(row, int) and not isinstance(row, bool))):
        raise InputError(f"{where}.row", f"{row!r}", "a whole number", "correct it")
    if gain is not None and not (isinstance(gain, int | float) and math.isfinite(gain) and gain != 0):
        raise InputError(f"{where}.gain", f"{gain!r}", "a number other than zero", "correct it")
    if measures == "current":
        factor = 1.0 if gain is None else float(gain)
    else:
        factor = Channel(value["column"], value.get("unit"), gain).factor(measures, where)
    return value["column"], factor, row


def _payload(value: Any, where: str) -> Payload | None:
    if value is None:
        return None
    need_known(value if isinstance(value, dict) else (), ("body", "mass", "pos"), where)
    if not isinstance(value, dict) or not {"body", "mass"} <= set(value):
        raise InputError(where, f"{value!r}", '{body = "name", mass = kg, pos = [x, y, z]}', "correct it")
    pos = value.get("pos", [0.0, 0.0, 0.0])
    three = isinstance(pos, list) and len(pos) == 3 and all(_is_number(x) for x in pos)
    if not (_is_number(value["mass"]) and value["mass"] >= 0 and three):
        raise InputError(where, f"{value!r}", "a mass in kg and a position of three numbers", "correct it")
    x, y, z = map(float, pos)
    return Payload(str(value["body"]), float(value["mass"]), (x, y, z))


def _is_number(x: Any) -> bool:
    """A finite number that is no boolean; of an integer, one that a float holds."""
    return isinstance(x, int | float) and not isinstance(x, bool) and -LARGEST <= x <= LARGEST


def find_robot_binding(recording: Path, model: Path | None = None) -> RobotBinding | None:
    """The sidecar beside the recording, else the robot's TOML beside the model; None where neither binds joints."""
    for candidate in (part_of(recording)[0].with_suffix(".toml"), model.with_suffix(".toml") if model else None):
        if candidate is not None and lies_at(candidate):
            binding = RobotBinding.from_toml(candidate)
            if binding is not None:
                return binding
    return None
