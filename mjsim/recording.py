"""A recording of one axis: torque or command in, velocity and angle out, in SI, with where it came from.

Read from CSV, MAT, NPZ, Parquet or MCAP. Which column is what, in which unit and with which gain is said by a *binding*: a table
``[recording]`` in a TOML file beside the recording (``log.csv`` -> ``log.toml``), else beside the model, else the default column
names (`mjsim.binding`). Of a robot's log one joint is read.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mjsim.binding import (
    DEFAULT_COLUMNS,
    DEFAULT_UNITS,
    INPUTS,
    NAMES,
    SI_UNITS,
    UNITS,
    Binding,
    Channel,
    joint_channels,
    joints_in,
)
from mjsim.errors import InputError, nearest
from mjsim.hold import HOLDS
from mjsim.readers import Table, digest, need_source, part_of, read_table
from mjsim.timebase import need_numbers, noise_after, off_by, onto_stamps, resample, sample_time, unrounded
from mjsim.toml import lies_at
from mjsim.unbound import by_headers, completed, guesses, without_input

__all__ = ["DEFAULT_COLUMNS", "UNITS", "Binding", "Channel", "Recording", "find_binding", "from_table", "load"]


def find_binding(recording: Path, model: Path | None = None) -> Binding:
    """The sidecar beside the recording, else the machine's TOML beside the model, else the default names."""
    for candidate in (part_of(recording)[0].with_suffix(".toml"), model.with_suffix(".toml") if model else None):
        if candidate is not None and lies_at(candidate):
            binding = Binding.from_toml(candidate)
            if binding is not None:
                return binding
    return Binding.default()


ARRAYS = (
    "time", "torque", "velocity", "angle", "second_angle", "second_velocity", "command", "current", "supply", "known_torque",
    "control", "temperature",
)  # fmt: skip


@dataclass(frozen=True)
class Recording:
    """One experiment on one axis, sampled uniformly; arrays (N,) are read-only and in SI.

    time [s]; torque: commanded input [N m | N], not a number where the log has none and the input is the ``command`` of a servo
    [rad | m, per second for a velocity]; velocity [rad/s | m/s] and angle [rad | m] of body 0, either may be None; second_angle,
    second_velocity: behind the gear; control: input of the actuator, in its own units, where it is not yet known to be a torque
    or a command (`mjsim.control`); current [A], supply [V], temperature [degC]; known_torque: on body 0, beside the drive's
    [N m | N]; hold: how the input goes between samples (`mjsim.hold`); joint: its name in a robot's log; known: values of
    this experiment; columns: every numeric column as it stands in the file; units: SI unit of a role (torque, velocity, ...)
    where the binding tells it; dt [s]; source: file name; sha256 of the file; loop, judge: what the binding states; notes:
    what reading changed; noise: rms of the noise of a channel, where reading changed it; driven: False where the drive was
    off and the torque is zero; control_column: name of the column of ``control``; hold_stated: whether the binding states hold;
    missing (N,) bool: samples that lie in gaps of the stamps and were not measured, None where there are none.

    >>> import numpy as np
    >>> t = np.arange(5) * 0.01
    >>> recording = Recording(t, torque=np.ones(5), velocity=2 * t, angle=None, dt=0.01)
    >>> len(recording), recording.duration
    (5, 0.04)
    >>> list(recording.signals())
    ['time_s', 'torque_Nm', 'velocity_rad_s']
    >>> recording.slice(1, 3).velocity
    array([0.02, 0.04])
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
    command: np.ndarray | None = None
    current: np.ndarray | None = None
    supply: np.ndarray | None = None
    known_torque: np.ndarray | None = None
    hold: str = "held"
    joint: str = ""
    known: Mapping[str, float] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()
    noise: Mapping[str, float] = dataclasses.field(default_factory=dict)
    control: np.ndarray | None = None
    control_column: str = ""
    driven: bool = True
    hold_stated: bool = False
    temperature: np.ndarray | None = None
    missing: np.ndarray | None = None

    def __post_init__(self) -> None:
        n = len(self.time)
        for name in ARRAYS:
            array = getattr(self, name)
            if array is None:
                continue
            array = np.array(array, float)
            if array.shape != (n,):
                raise ValueError(f"{name} has shape {array.shape}; expected ({n},)")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if self.hold not in HOLDS:
            raise ValueError(f"hold is {self.hold!r}; choose from {', '.join(HOLDS)}")
        for name in ("columns", "units", "known", "noise"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __len__(self) -> int:
        return len(self.time)

    @property
    def duration(self) -> float:
        """Length [s]."""
        return self.dt * (len(self) - 1)

    @property
    def input(self) -> np.ndarray:
        """What the model is driven by (N,): the command of a servo where there is one, else the control, else the torque."""
        if self.command is not None:
            return self.command
        return self.torque if self.control is None else self.control

    def column(self, name: str) -> np.ndarray:
        """A channel by its role (torque, velocity, angle) or a column of the file by its name."""
        if name in ARRAYS:
            array = getattr(self, name)
            if array is not None:
                return np.asarray(array)
        if name in self.columns:
            return self.columns[name]
        raise InputError(self.source, f"no column {name!r}", f"one of {', '.join(self.columns)}",
                         nearest(name, self.columns, "name one that is there"))  # fmt: skip

    def slice(self, start: int, stop: int) -> Recording:
        """The samples [start, stop) as a recording of their own."""
        cut = slice(start, stop)
        arrays: dict[str, Any] = {name: None if getattr(self, name) is None else getattr(self, name)[cut] for name in ARRAYS}
        columns = {k: v[cut] for k, v in self.columns.items()}
        missing = None if self.missing is None else self.missing[cut]
        return dataclasses.replace(self, **arrays, columns=columns, missing=missing)

    def signals(self) -> dict[str, np.ndarray]:
        """Time, input and outputs by their default column names, SI unit included: what `load` reads without a binding."""
        slide = self.units.get("angle") == "m" or self.units.get("velocity") == "m/s"
        roles = ("command", "control", "torque", "velocity", "angle", "second_angle", "current", "supply")
        out = {"time_s": self.time}
        for role in roles:
            array = getattr(self, role)
            if array is not None and not np.isnan(array).all() and (self.driven or role != "torque"):
                out[NAMES[role][1 if slide and len(NAMES[role]) > 1 else 0]] = array
        return out

    def save(self, path: str | Path) -> None:
        """Write `signals` to a .csv, .mcap, .npz or .parquet file, in one move. Raises InputError."""
        from mjsim.writers import write_table

        write_table(Path(path), self.signals())

    def to_frame(self) -> Any:
        """`signals` as a pandas DataFrame. Raises InputError where pandas is not installed."""
        try:
            import pandas
        except ImportError:
            raise InputError("to_frame", "the Python package 'pandas' is not installed", "it", "pip install pandas") from None
        return pandas.DataFrame(self.signals())


def load(
    path: str | Path, *, model: str | Path | None = None, binding: Binding | None = None, joint: str | None = None,
    prefer: str | None = None, uniform: bool = True, driven: bool = True,
) -> Recording:  # fmt: skip
    """Read a recording; the binding is looked for beside it and beside ``model`` when none is given.

    ``joint``: which one of a robot's log; ``prefer``: the one to take, if it is there, when none is named;
    ``uniform``: refuse stamps that are not, else they stay as they are and ``dt`` is their median step; ``driven``: whether the
    model has an actuator, else the log needs no input. Raises InputError naming the file, the row or key, what was expected and
    what to do.
    """
    path = Path(path)
    need_source(path)
    binding = binding or find_binding(path, Path(model) if model else None)
    return from_table(path, read_table(path), binding, joint=joint, prefer=prefer, uniform=uniform, sha256=digest(path),
                      driven=driven)  # fmt: skip


def from_table(
    path: Path, table: Table, binding: Binding, *, joint: str | None = None, prefer: str | None = None, uniform: bool = True,
    sha256: str = "", driven: bool = True,
) -> Recording:  # fmt: skip
    """The recording that a table of columns holds, as `load` reads it; ``path``: how messages name the source."""
    given = binding
    binding, joint = _bound(path, binding, table, joint, prefer, driven)
    has_input = any(role in binding.channels for role in INPUTS)
    if not has_input and driven and binding.driven:
        raise InputError(
            binding.source, "no torque channel bound", "torque = ..., command = ... or control = ...",
            f"add it to [recording]; {DRIVE_OFF}",
        )  # fmt: skip
    arrays = _arrays(path, table, binding)
    count = len(arrays["time"])
    notes = [*table.notes, *guesses(given, binding)]
    stamps = arrays.pop("command_time", None)
    if stamps is not None and "command" in arrays:
        arrays["command"], note = onto_stamps(path, arrays["command"], stamps, arrays["time"])
        notes += [note] if note else []
    arrays["time"], note = unrounded(arrays["time"])
    notes += [note] if note else []
    flat, noise = table.of_length(count), dict[str, float]()
    dt = sample_time(path, arrays["time"], binding.jitter, uniform=uniform, gaps=True)
    if binding.jitter and off_by(arrays["time"], dt, gaps=True) <= binding.jitter:
        stamps, before = arrays["time"], arrays
        arrays, note = resample(arrays, binding.hold, dt)
        if note:
            noise = noise_after(stamps, {k: v for k, v in before.items() if k in ("velocity", "angle")}, dt)
        flat = {}
        notes += [note] if note else []
    if not has_input:
        arrays["torque"] = np.zeros(len(arrays["time"]))
    units, column = _units(binding), binding.channels["control"].column if "control" in binding.channels else ""
    return Recording(
        dt=dt, source=path.name, sha256=sha256, columns=flat,
        loop=binding.loop, judge=binding.judge if has_input else "motion", driven=has_input,
        control_column=column, varies=binding.varies, units=units, hold=binding.hold,
        hold_stated=binding.hold_stated, joint=joint or "",
        known=binding.known, notes=tuple(notes), noise=noise, missing=arrays.get("missing"),
        **{name: arrays.get(name) for name in ARRAYS if name != "torque"},  # type: ignore[arg-type]
        torque=arrays.get("torque", np.full(len(arrays["time"]), np.nan)),
    )  # fmt: skip


def _arrays(path: Path, table: Table, binding: Binding) -> dict[str, np.ndarray]:
    """The bound channels and the time, each (N,) in SI and finite. Raises InputError."""
    arrays = {role: _values(path, table, role, channel, binding) for role, channel in binding.channels.items()}
    if "velocity" not in arrays and "angle" not in arrays:
        raise _no_response(path, table)
    role = next(r for r in (*INPUTS, "angle", "velocity") if r in arrays)
    count = len(arrays[role])
    if "time" not in arrays:
        if not binding.dt:
            raise InputError(path, "no time column", "time or dt", "bind 'time', or give 'dt' in [recording]")
        arrays["time"] = binding.dt * np.arange(count)
    for name, array in arrays.items():
        if len(array) != count:
            raise InputError(path, f"{name} has {len(array)} samples, {role} {count}", "equal lengths", "cut them alike")
        need_numbers(path, name, array)
    return arrays


COMMAND_UNITS = dict(zip(NAMES["command"], ("rad", "m", "rad/s", "m/s"), strict=True))
"""SI unit of a command by the default name of its column."""


def _units(binding: Binding) -> dict[str, str]:
    """SI unit of each role that the binding tells it of."""
    command = binding.channels.get("command")
    by_name = {} if command is None or command.unit is not None else {"command": COMMAND_UNITS.get(command.column, "")}
    if not binding.named:
        return {**DEFAULT_UNITS, **by_name}
    units = by_name | {role: SI_UNITS.get(c.unit, "") for role, c in binding.channels.items() if c.unit is not None}
    control = binding.channels.get("control")
    if control is not None and control.unit in ("A", "mA", "V", "mV"):
        units["control"] = control.unit[-1]
    return units


def _no_response(path: Path, table: Table) -> InputError:
    """The one line for a log without velocity and angle, with what an acceleration is good for where there is one."""
    found = next((f", only {name!r}" for name in table if "accel" in name.lower()), "")
    todo = " (integrate the acceleration to a velocity)" if found else ""
    return InputError(
        path, f"neither velocity nor angle{found}", f"one of {DEFAULT_COLUMNS['velocity']}, {DEFAULT_COLUMNS['angle']}",
        table.hint or f"add a column or bind one {_in_binding(path)}{todo}",
    )  # fmt: skip


DRIVE_OFF = 'where the drive was off, write input = "none" there'


def _in_binding(path: Path) -> str:
    """Where a column is bound: the sidecar of a file; ``binding`` for data in memory, whose name has no ending."""
    return f"in {path.with_suffix('.toml').name}" if path.suffix else "by binding"


def _bound(
    path: Path, binding: Binding, table: Table, joint: str | None, prefer: str | None, driven: bool
) -> tuple[Binding, str | None]:  # fmt: skip
    """The binding of one joint, and its name where the log is a robot's."""
    names = list(binding.joints) or ([] if binding.named else joints_in(table))
    if not names or (joint is None and not binding.joints and "angle_rad" in table):
        if joint is not None:
            raise InputError("--joint", f"{joint!r}, and {path.name} names no joints", "a log with JOINT.angle_rad columns",
                             "leave it out, or bind [joints.NAME]")  # fmt: skip
        bind = completed if binding.named else by_headers
        return bind(binding, table, driven=driven), None
    if joint is None and prefer in names:
        joint = prefer
    if joint is None and len(names) > 1:
        raise InputError(path, f"it holds {len(names)} joints", "one that is chosen", f"--joint, one of {', '.join(names)}")
    joint = joint or names[0]
    if joint not in names:
        raise InputError(
            "--joint", f"{joint!r} is not in {path.name}", f"one of {', '.join(names)}", nearest(joint, names, "correct the name")
        )
    if binding.joints:
        return binding.of_joint(joint), joint
    channels = joint_channels(table, joint)
    if not binding.driven:
        channels = without_input(channels)
    return dataclasses.replace(binding, channels=channels), joint


def _values(path: Path, table: Table, role: str, channel: Channel, binding: Binding) -> np.ndarray:
    """The values (N,) of a bound channel in SI."""
    where = f"{binding.source}: {role}"
    if channel.column not in table:
        unit = f', unit = "{DEFAULT_UNITS[role]}"' if role in DEFAULT_UNITS else ""
        off = f', as [recording] {role} = {{ column = "NAME"{unit} }}' + (f"; {DRIVE_OFF}" if role in INPUTS else "")
        raise InputError(
            path, f"no column {channel.column!r} for {role}", f"one of the columns {', '.join(table) or '(none)'}",
            table.hint or nearest(channel.column, table, f"rename it, or bind it {_in_binding(path)}{off}"),
        )  # fmt: skip
    array = table[channel.column]
    if channel.row is not None:
        if array.ndim != 2 or not 0 <= channel.row < array.shape[0]:
            raise InputError(
                where, f"row {channel.row} of {channel.column!r} with shape {array.shape}", "a row of a matrix", "correct it"
            )
        array = array[channel.row]
    if array.ndim != 1:
        raise InputError(path, f"{channel.column!r} has shape {array.shape}", "one value per sample", "name a row in the binding")
    return np.asarray(array * channel.factor(Binding.MEASURES[role], where))
