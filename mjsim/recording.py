"""A recording of one axis: torque in, velocity and angle out, in SI, with where it came from.

Read from CSV, MAT, NPZ, Parquet or MCAP. Which column is what, in which unit and with which gain is said by a *binding*: a table
``[recording]`` in a TOML file beside the recording (``log.csv`` -> ``log.toml``), else beside the model, else the default column
names. See `Binding` for the keys.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mjsim.errors import InputError
from mjsim.readers import read_table

__all__ = ["DEFAULT_COLUMNS", "UNITS", "Binding", "Channel", "Recording", "find_binding", "load"]

DEFAULT_COLUMNS = {"time": "time_s", "torque": "torque_Nm", "velocity": "velocity_rad_s", "angle": "angle_rad"}
DEFAULT_UNITS = {"time": "s", "torque": "Nm", "velocity": "rad/s", "angle": "rad"}

# unit -> (factor to SI, what it measures)
UNITS: dict[str, tuple[float, str]] = {
    "s": (1.0, "time"), "ms": (1e-3, "time"), "us": (1e-6, "time"), "ns": (1e-9, "time"),
    "rad": (1.0, "angle"), "deg": (math.pi / 180, "angle"), "rev": (2 * math.pi, "angle"), "mrad": (1e-3, "angle"),
    "m": (1.0, "angle"), "mm": (1e-3, "angle"), "um": (1e-6, "angle"),
    "rad/s": (1.0, "velocity"), "deg/s": (math.pi / 180, "velocity"), "rpm": (math.pi / 30, "velocity"),
    "m/s": (1.0, "velocity"), "mm/s": (1e-3, "velocity"),
    "Nm": (1.0, "torque"), "N m": (1.0, "torque"), "mNm": (1e-3, "torque"), "kNm": (1e3, "torque"),
    "N": (1.0, "torque"), "kN": (1e3, "torque"),
    "V": (math.nan, "torque"), "A": (math.nan, "torque"), "1": (math.nan, "torque"),
}  # fmt: skip

SI_UNITS = {
    "m": "m", "mm": "m", "um": "m", "m/s": "m/s", "mm/s": "m/s", "N": "N", "kN": "N", "V": "", "A": "", "1": "",
    "Nm": "Nm", "N m": "Nm", "mNm": "Nm", "kNm": "Nm", "rad/s": "rad/s", "deg/s": "rad/s", "rpm": "rad/s",
    "rad": "rad", "deg": "rad", "rev": "rad", "mrad": "rad", "s": "s", "ms": "s", "us": "s", "ns": "s",
}  # fmt: skip
"""Unit of a binding -> that of the values once they are in SI; empty where the gain decides (newton or newton metre)."""


@dataclass(frozen=True)
class Channel:
    """One bound channel: column (of a struct ``rec.x``; ``row`` of a matrix), its unit and gain (SI value per unit, as N/V)."""

    column: str
    unit: str | None = None
    gain: float | None = None
    row: int | None = None

    def factor(self, measures: str, where: str) -> float:
        """Multiplier that turns the column into SI."""
        if self.unit is None:
            return 1.0 if self.gain is None else self.gain
        if self.unit not in UNITS:
            raise InputError(where, f"unit {self.unit!r} is not known", f"one of {', '.join(UNITS)}", "correct the unit")
        factor, kind = UNITS[self.unit]
        if kind != measures:
            raise InputError(where, f"unit {self.unit!r} measures {kind}", f"a unit of {measures}", "correct the unit")
        if math.isnan(factor):
            if self.gain is None:
                raise InputError(
                    where, f"unit {self.unit!r} has no gain", "gain = torque or force per unit", "add the key 'gain'"
                )
            return self.gain
        return factor * (1.0 if self.gain is None else self.gain)


@dataclass(frozen=True)
class Binding:
    """Which column is what.

    TOML: ``[recording]`` with ``time``, ``torque``, ``velocity``, ``angle``, each a column name or a table
    ``{column, unit, gain, row}``; instead of a time column, ``dt`` [s]. ``second_angle``, ``second_velocity`` bind a link-side
    encoder. ``[experiment]`` with ``loop`` = "open" | "closed", ``judge`` = "motion" | "force", and ``varies`` = names of linear
    parameters that each recording has of its own (an inertia that depends on the pose of other axes).
    """

    channels: Mapping[str, Channel]
    dt: float | None = None
    loop: str | None = None
    judge: str | None = None
    varies: tuple[str, ...] = ()
    source: str = "default column names"

    CHANNELS = ("time", "torque", "velocity", "angle", "second_angle", "second_velocity")
    MEASURES = MappingProxyType(dict(zip(CHANNELS, ("time", "torque", "velocity", "angle", "angle", "velocity"), strict=True)))

    @classmethod
    def default(cls) -> Binding:
        """The default column names, in SI."""
        return cls({k: Channel(c) for k, c in DEFAULT_COLUMNS.items()})

    @classmethod
    def from_toml(cls, path: Path) -> Binding | None:
        """The binding that a TOML file states, or None when it has no ``[recording]`` table."""
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(path, f"not valid TOML ({error})", "a TOML file", "correct it") from None
        if "recording" not in table and "experiment" not in table:
            return None
        given = table.get("recording", {})
        experiment = table.get("experiment", {})
        channels = {}
        for key, value in given.items():
            if key == "dt":
                continue
            if key not in cls.CHANNELS:
                raise InputError(
                    f"{path}: [recording]", f"key {key!r} is not known", f"{', '.join(cls.CHANNELS)} or dt", "rename it"
                )
            if isinstance(value, str):
                value = {"column": value}
            if not isinstance(value, dict) or "column" not in value:
                raise InputError(
                    f"{path}: [recording] {key}", "no column named", '"name" or {column = "name", unit = ...}', "add it"
                )
            unknown = set(value) - {"column", "unit", "gain", "row"}
            if unknown:
                raise InputError(
                    f"{path}: [recording] {key}",
                    f"key {sorted(unknown)[0]!r} is not known",
                    "column, unit, gain or row",
                    "rename it",
                )
            channels[key] = Channel(**_checked(value, f"{path}: [recording] {key}"))
        for key, choices in (("loop", ("open", "closed")), ("judge", ("motion", "force"))):
            if experiment.get(key) not in (None, *choices):
                raise InputError(f"{path}: [experiment] {key}", f"{experiment[key]!r}", " or ".join(choices), "correct it")
        if not channels:
            channels = dict(cls.default().channels)
        varies = experiment.get("varies", [])
        if not isinstance(varies, list) or not all(isinstance(v, str) for v in varies):
            raise InputError(f"{path}: [experiment] varies", f"{varies!r}", 'a list of names, as ["Jm"]', "correct it")
        dt = given.get("dt")
        if dt is not None and not (_is_number(dt) and 0 < dt < math.inf):
            raise InputError(f"{path}: [recording] dt", f"{dt!r}", "a sample time in seconds, above zero", "correct it")
        return cls(channels, dt, experiment.get("loop"), experiment.get("judge"), tuple(varies), str(path))


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


def find_binding(recording: Path, model: Path | None = None) -> Binding:
    """The sidecar beside the recording, else the machine's TOML beside the model, else the default names."""
    for candidate in (recording.with_suffix(".toml"), model.with_suffix(".toml") if model else None):
        if candidate is not None and candidate.is_file():
            binding = Binding.from_toml(candidate)
            if binding is not None:
                return binding
    return Binding.default()


@dataclass(frozen=True)
class Recording:
    """One experiment on one axis, sampled uniformly; arrays (N,) are read-only and in SI.

    time [s]; torque: commanded input [N m | N]; velocity [rad/s | m/s] and angle [rad | m] of body 0, either may be None;
    columns: every numeric column as it stands in the file; units: SI unit of a role (torque, velocity, ...) where the binding
    tells it; dt [s]; source: file name; sha256 of the file; loop, judge: what the binding states.
    """

    time: np.ndarray
    torque: np.ndarray
    velocity: np.ndarray | None
    angle: np.ndarray | None
    dt: float
    source: str = "memory"
    sha256: str = ""
    columns: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    second_angle: np.ndarray | None = None
    second_velocity: np.ndarray | None = None
    loop: str | None = None
    judge: str | None = None
    varies: tuple[str, ...] = ()
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.time)
        for name in ("time", "torque", "velocity", "angle", "second_angle", "second_velocity"):
            array = getattr(self, name)
            if array is None:
                continue
            array = np.array(array, float)
            if array.shape != (n,):
                raise ValueError(f"{name} has shape {array.shape}; expected ({n},)")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        for name in ("columns", "units"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __len__(self) -> int:
        return len(self.time)

    @property
    def duration(self) -> float:
        """Length [s]."""
        return self.dt * (len(self) - 1)

    def column(self, name: str) -> np.ndarray:
        """A channel by its role (torque, velocity, angle) or a column of the file by its name."""
        if name in ("time", "torque", "velocity", "angle", "second_angle", "second_velocity"):
            array = getattr(self, name)
            if array is not None:
                return np.asarray(array)
        if name in self.columns:
            return self.columns[name]
        raise InputError(self.source, f"no column {name!r}", f"one of {', '.join(self.columns)}", "name one that is there")

    def slice(self, start: int, stop: int) -> Recording:
        """The samples [start, stop) as a recording of their own."""
        cut = slice(start, stop)
        arrays: dict[str, Any] = {
            name: None if getattr(self, name) is None else getattr(self, name)[cut]
            for name in ("time", "torque", "velocity", "angle", "second_angle", "second_velocity")
        }
        columns = {k: v[cut] for k, v in self.columns.items()}
        return dataclasses.replace(self, **arrays, columns=columns)


def load(path: str | Path, *, model: str | Path | None = None, binding: Binding | None = None, uniform: bool = True) -> Recording:
    """Read a recording; the binding is looked for beside it and beside ``model`` when none is given.

    ``uniform``: refuse stamps that are not; else they stay as they are, and ``dt`` is their median step.

    Raises InputError naming the file, the row or key, what was expected and what to do.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "no such file", "a recording (.csv, .mat, .npz, .parquet, .mcap)", "check the path")
    binding = binding or find_binding(path, Path(model) if model else None)
    table = read_table(path)
    if "torque" not in binding.channels:
        raise InputError(binding.source, "no torque channel bound", "torque = ...", "add it to [recording]")
    arrays: dict[str, np.ndarray] = {}
    is_default = binding.source == Binding.default().source
    for role, channel in binding.channels.items():
        where = f"{binding.source}: {role}"
        if channel.column not in table:
            if is_default and role in ("velocity", "angle"):
                continue
            raise InputError(
                path, f"no column {channel.column!r} for {role}", f"columns found: {', '.join(table) or 'none'}",
                f"rename it, or bind it in {path.with_suffix('.toml').name}",
            )  # fmt: skip
        array = table[channel.column]
        if channel.row is not None:
            if array.ndim != 2 or not 0 <= channel.row < array.shape[0]:
                raise InputError(
                    where,
                    f"row {channel.row} of {channel.column!r} with shape {array.shape}",
                    "a row of a matrix",
                    "correct it",
                )
            array = array[channel.row]
        if array.ndim != 1:
            raise InputError(
                path, f"{channel.column!r} has shape {array.shape}", "one value per sample", "name a row in the binding"
            )
        arrays[role] = array * channel.factor(Binding.MEASURES[role], where)
    if "velocity" not in arrays and "angle" not in arrays:
        raise InputError(path, "neither velocity nor angle", f"one of {DEFAULT_COLUMNS['velocity']}, {DEFAULT_COLUMNS['angle']}",
                         f"add a column or bind one in {path.with_suffix('.toml').name}")  # fmt: skip
    count = len(arrays["torque"])
    if "time" not in arrays:
        if not binding.dt:
            raise InputError(path, "no time column", "time or dt", "bind 'time', or give 'dt' in [recording]")
        arrays["time"] = binding.dt * np.arange(count)
    for role, array in arrays.items():
        if len(array) != count:
            raise InputError(path, f"{role} has {len(array)} samples, torque {count}", "equal lengths", "cut them alike")
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad):
            raise InputError(
                path, f"{role} is not finite in {_row(path, bad[0])}", "a number", "remove or interpolate these samples"
            )
    dt = _sample_time(path, arrays["time"], uniform=uniform)
    units = {role: SI_UNITS.get(c.unit, "") for role, c in binding.channels.items() if c.unit is not None}
    if is_default:
        units = dict(DEFAULT_UNITS)
    flat = table.of_length(count)
    return Recording(
        time=arrays["time"], torque=arrays["torque"], velocity=arrays.get("velocity"), angle=arrays.get("angle"), dt=dt,
        source=path.name, sha256=hashlib.sha256(path.read_bytes()).hexdigest(), columns=flat,
        second_angle=arrays.get("second_angle"), second_velocity=arrays.get("second_velocity"),
        loop=binding.loop, judge=binding.judge, varies=binding.varies, units=units,
    )  # fmt: skip


def _row(path: Path, index: int) -> str:
    """How a user finds a sample in the file: by its row in a CSV, of which the header is row 1, else by its number from 1 on."""
    return f"row {index + 2}" if path.suffix.lower() == ".csv" else f"sample {index + 1}"


def _sample_time(path: Path, time: np.ndarray, *, uniform: bool) -> float:
    """The uniform sample time, or an InputError that names the row at which it is not; the median step where that is allowed."""
    if len(time) < 2:
        raise InputError(path, f"{len(time)} samples", "at least two", "record longer")
    step = np.diff(time)
    back = np.flatnonzero(step <= 0)
    if len(back):
        raise InputError(
            path, f"time does not increase at {_row(path, back[0] + 1)}", "increasing time", "sort or remove these rows"
        )
    dt = float((time[-1] - time[0]) / (len(time) - 1))
    # a printed time stamp is rounded; a missing or shifted sample is off by a good part of dt
    off = np.flatnonzero(np.abs(step - dt) > 0.05 * dt)
    if len(off) and not uniform:
        return float(f"{np.median(step):.9g}")
    if len(off):
        raise InputError(
            path, f"sample time {step[off[0]]:.6g} s at {_row(path, off[0] + 1)}, elsewhere {dt:.6g} s", "uniform sampling",
            "resample to a uniform grid first; if only the stamps jitter, give [recording] dt in the binding, and no time",
        )  # fmt: skip
    return float(f"{dt:.9g}")
