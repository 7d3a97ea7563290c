"""Which column of a file is what: `Binding`, read from TOML, or the default names.

``[recording]``: ``time``, ``torque``, ``command`` (of a servo), ``control`` (of the actuator, whatever it is), ``velocity``,
``angle``, ``current``, ``supply``, ``second_angle``, ``second_velocity``, ``known_torque``, ``command_time``, each a column name
or a table ``{column, unit, gain, row}``; ``dt`` [s] instead of a time column; ``hold`` = "held" | "linear" | "mean": how the
input goes between samples (`mjsim.hold`); ``input`` = "none": the drive was off; ``jitter``: stamps may be off by this part of
the sample time, and are resampled uniformly. What is not named is looked for by the default names and by headers.
``[joints.NAME]``: the same channels of one joint of a robot.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

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
from mjsim.toml import toml_at

__all__ = [
    "DEFAULT_COLUMNS",
    "INPUTS",
    "NAMES",
    "SI_UNITS",
    "UNITS",
    "Binding",
    "Channel",
    "joint_channels",
    "joints_in",
    "plain_channels",
]

DEFAULT_COLUMNS = {"time": "time_s", "torque": "torque_Nm", "velocity": "velocity_rad_s", "angle": "angle_rad"}
DEFAULT_SOURCE = "default column names"
DEFAULT_UNITS = {"time": "s", "torque": "Nm", "velocity": "rad/s", "angle": "rad"}

INCH, POUND, KILOPOND = 0.0254, 4.4482216152605, 9.80665  # [m], [N], [N]: NIST SP 811, exact

# unit -> (factor to SI, what it measures)
UNITS: dict[str, tuple[float, str]] = {
    "s": (1.0, "time"), "ms": (1e-3, "time"), "us": (1e-6, "time"), "ns": (1e-9, "time"),
    "rad": (1.0, "angle"), "deg": (math.pi / 180, "angle"), "rev": (2 * math.pi, "angle"), "mrad": (1e-3, "angle"),
    "m": (1.0, "angle"), "mm": (1e-3, "angle"), "um": (1e-6, "angle"),
    "cm": (1e-2, "angle"), "in": (INCH, "angle"), "ft": (12 * INCH, "angle"),
    "rad/s": (1.0, "velocity"), "deg/s": (math.pi / 180, "velocity"), "rpm": (math.pi / 30, "velocity"),
    "rev/s": (2 * math.pi, "velocity"),
    "m/s": (1.0, "velocity"), "mm/s": (1e-3, "velocity"), "in/s": (INCH, "velocity"), "ft/s": (12 * INCH, "velocity"),
    "Nm": (1.0, "torque"), "N m": (1.0, "torque"), "mNm": (1e-3, "torque"), "kNm": (1e3, "torque"),
    "Ncm": (1e-2, "torque"), "lbf in": (POUND * INCH, "torque"), "lbf ft": (12 * POUND * INCH, "torque"),
    "ozf in": (POUND * INCH / 16, "torque"), "kgf cm": (KILOPOND * 1e-2, "torque"),
    "N": (1.0, "torque"), "kN": (1e3, "torque"), "lbf": (POUND, "torque"), "kip": (1e3 * POUND, "torque"),
    "kgf": (KILOPOND, "torque"),
    "V": (math.nan, "torque"), "A": (math.nan, "torque"), "1": (math.nan, "torque"), "mA": (math.nan, "torque"),
    "mV": (math.nan, "torque"), "degC": (1.0, "temperature"), "°C": (1.0, "temperature"),
}  # fmt: skip
_AMPERES, _VOLTS = {"A": 1.0, "mA": 1e-3}, {"V": 1.0, "mV": 1e-3}
_OWN = {"current": _AMPERES, "voltage": _VOLTS, "control": {**_AMPERES, **_VOLTS, "1": 1.0}}  # of channels that are no torque

SI_UNITS = {
    "m": "m", "mm": "m", "um": "m", "cm": "m", "in": "m", "ft": "m",
    "m/s": "m/s", "mm/s": "m/s", "in/s": "m/s", "ft/s": "m/s",
    "N": "N", "kN": "N", "lbf": "N", "kip": "N", "kgf": "N",
    "Ncm": "Nm", "lbf in": "Nm", "lbf ft": "Nm", "ozf in": "Nm", "kgf cm": "Nm", "rev/s": "rad/s",
    "V": "", "A": "", "1": "", "mA": "", "mV": "",
    "Nm": "Nm", "N m": "Nm", "mNm": "Nm", "kNm": "Nm", "rad/s": "rad/s", "deg/s": "rad/s", "rpm": "rad/s",
    "rad": "rad", "deg": "rad", "rev": "rad", "mrad": "rad", "s": "s", "ms": "s", "us": "s", "ns": "s",
    "degC": "degC", "°C": "degC",
}  # fmt: skip
"""Unit of a binding -> that of the values once they are in SI; empty where the gain decides (newton or newton metre)."""


@dataclass(frozen=True)
class Channel:
    """One bound channel: column (of a struct ``rec.x``; ``row`` of a matrix), its unit and gain.

    The gain is the SI value per ampere, volt or count of a unit of these, as N m/A of a column in mA; of another unit a factor.
    """

    column: str
    unit: str | None = None
    gain: float | None = None
    row: int | None = None

    def factor(self, measures: str, where: str) -> float:
        """Multiplier that turns the column into SI."""
        if self.unit is None:
            return 1.0 if self.gain is None else self.gain
        if self.unit not in UNITS:
            known = [u for u, (_, kind) in UNITS.items() if kind == measures or u in _OWN.get(measures, ())] or list(UNITS)
            raise InputError(
                where, f"unit {self.unit!r} is not known", f"one of {', '.join(known)}",
                nearest(self.unit, known, "correct the unit"),
            )  # fmt: skip
        factor, kind = UNITS[self.unit]
        if measures == "command" and kind in ("angle", "velocity"):
            measures = kind
        if measures in _OWN and self.unit in _OWN[measures]:
            return _OWN[measures][self.unit] * (1.0 if self.gain is None else self.gain)
        if self.unit == "1" and self.gain is not None:
            return self.gain  # counts, of which the gain says what one is in SI
        if kind != measures:
            raise InputError(where, f"unit {self.unit!r} measures {kind}", f"a unit of {measures}", "correct the unit")
        if math.isnan(factor):
            if self.gain is None:
                per = f"gain = torque or force per {self.unit.removeprefix('m')}"
                raise InputError(where, f"unit {self.unit!r} has no gain", per, "add the key 'gain'")
            return {**_AMPERES, **_VOLTS, "1": 1.0}[self.unit] * self.gain
        return factor * (1.0 if self.gain is None else self.gain)


@dataclass(frozen=True)
class Binding:
    """Which column is what, and what is known of the experiment (see the module's text for the keys).

    channels: by role; joints: the same of each joint of a robot, by name. ``[experiment]`` with ``loop`` = "open" | "closed",
    ``judge`` = "motion" | "force", ``varies`` = names of linear parameters that each recording has of its own (an inertia that
    depends on the pose of other axes), and values that are ``known``: ``kp``, ``kv`` of the servo [SI], ``supply_V``. named:
    whether the channels are bound by name, and not by default; hold_stated: whether the binding says how the input is held;
    driven: False where the drive was off, so that its input is zero.
    """

    channels: Mapping[str, Channel]
    dt: float | None = None
    loop: str | None = None
    judge: str | None = None
    varies: tuple[str, ...] = ()
    source: str = DEFAULT_SOURCE
    hold: str = "held"
    jitter: float = 0.0
    joints: Mapping[str, Mapping[str, Channel]] = field(default_factory=dict)
    known: Mapping[str, float] = field(default_factory=dict)
    named: bool = True
    driven: bool = True
    hold_stated: bool = False

    CHANNELS = (
        "time", "torque", "velocity", "angle", "second_angle", "second_velocity", "command", "current", "supply", "known_torque",
        "command_time", "control", "temperature",
    )  # fmt: skip
    MEASURES = MappingProxyType(
        {
            "time": "time", "torque": "torque", "velocity": "velocity", "angle": "angle", "second_angle": "angle",
            "second_velocity": "velocity", "command": "command", "current": "current", "supply": "voltage",
            "known_torque": "torque", "command_time": "time", "control": "control",
            "temperature": "temperature",
        }
    )  # fmt: skip
    KNOWN = ("kp", "kv", "supply_V")

    @classmethod
    def default(cls) -> Binding:
        """The default column names, in SI."""
        return cls({k: Channel(c) for k, c in DEFAULT_COLUMNS.items()}, named=False)

    @classmethod
    def from_toml(cls, path: Path) -> Binding | None:
        """The binding that a TOML file states, or None when it has none of ``[recording]``, ``[joints]``, ``[experiment]``."""
        table = toml_at(path)
        need_no_model_table(table, path)
        return cls.from_tables(table, path)

    @classmethod
    def from_tables(cls, table: Mapping[str, Any], path: Path) -> Binding | None:
        """The binding that the tables of a TOML file state; ``path``: how messages name it. Raises InputError."""
        need_no_misspelt_table(table, path)
        if not {"recording", "experiment", "joints"} & set(table):
            return None
        given, experiment = table_of(table, "recording", path), table_of(table, "experiment", path)
        own: dict[str, Any] = {k: given[k] for k in OWN_KEYS if k in given}
        channels = _channels({k: v for k, v in given.items() if k not in own}, f"{path}: [recording]", (*cls.CHANNELS, *OWN_KEYS))
        joints = {
            name: _channels(table_of(table_of(table, "joints", path), name, path), f"{path}: [joints.{name}]", cls.CHANNELS)
            for name in table_of(table, "joints", path)
        }
        need_known_experiment(experiment, path)
        for key, choices in (("loop", ("open", "closed")), ("judge", ("motion", "force"))):
            if experiment.get(key) not in (None, *choices):
                raise InputError(
                    f"{path}: [experiment] {key}",
                    f"{experiment[key]!r}",
                    " or ".join(choices),
                    nearest(str(experiment[key]), choices, "correct it"),
                )
        varies = experiment.get("varies", [])
        if not isinstance(varies, list) or not all(isinstance(v, str) for v in varies):
            raise InputError(f"{path}: [experiment] varies", f"{varies!r}", 'a list of names, as ["Jm"]', "correct it")
        if "payload" in experiment:
            raise InputError(
                f"{path}: [experiment] payload", "it is used of robots only", "a model of one joint that holds its payload",
                "put the payload into the model, and remove the key",
            )  # fmt: skip
        return cls(
            channels or dict(cls.default().channels),
            _above_zero(own, "dt", path),
            experiment.get("loop"),
            experiment.get("judge"),
            tuple(varies),
            str(path),
            _choice(own, path),
            _above_zero(own, "jitter", path) or 0.0,
            joints,
            {k: _known(experiment, k, path) for k in cls.KNOWN if k in experiment},
            bool(channels),
            _driven(own, channels, path),
            hold_stated="hold" in own,
        )

    def of_joint(self, name: str) -> Binding:
        """The binding of one joint of ``joints``, with what all joints share (the time)."""
        shared = {k: c for k, c in self.channels.items() if k in ("time", "command_time")}
        return dataclasses.replace(self, channels={**shared, **self.joints[name]}, joints={}, named=True)


def _channels(given: Mapping[str, Any], where: str, known: tuple[str, ...]) -> dict[str, Channel]:
    """The channels of a table, by role."""
    channels = {}
    need_known([key for key in given if key not in Binding.CHANNELS], known, where, LEFT_OUT)
    for key, value in given.items():
        if isinstance(value, str):
            value = {"column": value}
        if not isinstance(value, dict) or "column" not in value:
            need_known(value if isinstance(value, dict) else (), CHANNEL_KEYS, f"{where} {key}")
            raise InputError(f"{where} {key}", "no column named", '"name" or {column = "name", unit = ...}', "add it")
        need_known(value, CHANNEL_KEYS, f"{where} {key}")
        channels[key] = Channel(**_checked(value, f"{where} {key}"))
    return channels


OWN_KEYS = ("dt", "hold", "jitter", "input")
LEFT_OUT = {"acceleration": "leave it out: velocity and angle are fitted; where neither is recorded, integrate it to a velocity"}


def _above_zero(own: Mapping[str, Any], key: str, path: Path) -> float | None:
    value, unit = own.get(key), {"dt": "a sample time in seconds", "jitter": "a part of the sample time"}[key]
    if value is not None and not (_is_number(value) and 0 < value < math.inf):
        raise InputError(f"{path}: [recording] {key}", f"{value!r}", f"{unit}, above zero", "correct it")
    return value


def _driven(own: Mapping[str, Any], channels: Collection[str], path: Path) -> bool:
    """Whether the drive was on: ``input`` = "none" says that it was off."""
    if own.get("input", "none") != "none":
        raise InputError(
            f"{path}: [recording] input", f"{own['input']!r}", '"none", where the drive was off',
            "bind the column of the input as torque, command or control",
        )  # fmt: skip
    bound = [role for role in INPUTS if role in channels]
    if "input" in own and bound:
        raise InputError(
            f"{path}: [recording]", f'input = "none", and a column for {bound[0]}', "one of them", "remove the other"
        )
    return "input" not in own


def _choice(own: Mapping[str, Any], path: Path) -> str:
    hold = own.get("hold", "held")
    if hold not in HOLDS:
        raise InputError(f"{path}: [recording] hold", f"{hold!r}", " or ".join(HOLDS), nearest(str(hold), HOLDS, "correct it"))
    return str(hold)


def _known(experiment: Mapping[str, Any], key: str, path: Path) -> float:
    value = experiment[key]
    if not (_is_number(value) and 0 < value < math.inf):
        raise InputError(f"{path}: [experiment] {key}", f"{value!r}", "a number above zero", "correct it")
    return float(value)


NAMES = {
    "command": ("command_rad", "command_m", "command_rad_s", "command_m_s"), "torque": ("torque_Nm", "torque_N"),
    "angle": ("angle_rad", "angle_m"), "velocity": ("velocity_rad_s", "velocity_m_s"),
    "second_angle": ("second_angle_rad", "second_angle_m"), "current": ("current_A",), "supply": ("supply_V",),
    "control": ("ctrl",),
}  # fmt: skip
"""Role -> the default names of its column, SI unit included."""

INPUTS = ("torque", "command", "control")
"""Roles of columns that can drive a model."""
SHARED = {"time": "time_s", "command_time": "command_time_s"}


def joints_in(columns: Collection[str]) -> list[str]:
    """Joints of which a log has a column by its default name (JOINT.angle_rad and the like), in the order of its columns."""
    ends = {name for names in NAMES.values() for name in names}
    found = (c.rpartition(".") for c in columns)
    return list(dict.fromkeys(joint for joint, _, end in found if joint and end in ends))


def joint_channels(columns: Collection[str], joint: str) -> dict[str, Channel]:
    """The channels of one joint by the default names."""
    found = {role: next((f"{joint}.{n}" for n in names if f"{joint}.{n}" in columns), None) for role, names in NAMES.items()}
    found |= {role: name for role, name in SHARED.items() if name in columns}
    return {role: Channel(name) for role, name in found.items() if name is not None}


def plain_channels(columns: Collection[str], *, needed: bool = True) -> dict[str, Channel]:
    """The channels of a single axis by the default names: those that stand in the log, and those that it needs.

    ``needed``: whether it needs an input.
    """
    found = {role: next((n for n in names if n in columns), None) for role, names in NAMES.items()}
    found |= {role: name for role, name in SHARED.items() if name in columns}
    channels = {role: Channel(name) for role, name in found.items() if name is not None}
    channels.setdefault("time", Channel(DEFAULT_COLUMNS["time"]))
    if needed and not {"command", "control"} & set(channels):
        channels.setdefault("torque", Channel(DEFAULT_COLUMNS["torque"]))
    return channels


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _checked(value: dict[str, Any], where: str) -> dict[str, Any]:
    """The keys of a bound channel, each of its kind."""
    kinds = {"column": ("a column name in quotes", str), "unit": ("a unit in quotes", str), "row": ("a whole number", int)}
    for key, (expected, kind) in kinds.items():
        if key in value and (not isinstance(value[key], kind) or isinstance(value[key], bool)):
            raise InputError(f"{where}.{key}", f"{value[key]!r}", expected, "correct it")
    if "gain" in value and not (_is_number(value["gain"]) and math.isfinite(value["gain"]) and value["gain"] != 0):
        raise InputError(f"{where}.gain", f"{value['gain']!r}", "a number other than zero", "correct it")
    return value
