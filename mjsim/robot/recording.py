"""A recording of a robot: channels of several joints on one time grid, in SI.

Columns are named after the MJCF joints: ``JOINT.command_rad``, ``JOINT.torque_Nm``, ``JOINT.angle_rad``,
``JOINT.velocity_rad_s``,
``JOINT.current_A``, ``JOINT.second_angle_rad``; ``_m``, ``_N``, ``_m_s`` on slides. Other names are bound by ``[joints.NAME]`` in
a TOML file beside the recording, else beside the model (`mjsim.robot.binding`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mjsim.errors import InputError, nearest
from mjsim.quantity import Motion
from mjsim.readers import Table, digest, is_source, need_source, read_table
from mjsim.robot.binding import CHANNELS, Payload, RobotBinding, find_robot_binding
from mjsim.robot.model import Robot
from mjsim.timebase import need_numbers, off_by, resample, sample_time, unrounded, where_in

__all__ = ["RobotRecording", "joints_in_table", "joints_named", "load_robot_recording", "robot_from_table"]

SUFFIXES = {
    Motion.HINGE: dict(zip(CHANNELS, ("rad", "Nm", "rad", "rad_s", "A", "rad"), strict=True)),
    Motion.SLIDE: dict(zip(CHANNELS, ("m", "N", "m", "m_s", "A", "m"), strict=True)),
}
_COLUMN = re.compile(rf"^(?P<joint>.+)\.(?P<channel>{'|'.join(CHANNELS)})_(?P<unit>rad|Nm|rad_s|A|m|N|m_s)$")
ALIKE, UNLIKE = 0.9, 0.5  # correlation of a command with the position that follows it, and with one that does not
BEYOND = 0.01  # of a joint's range: how far a position may lie outside, for an encoder that is not zeroed to the last digit


@dataclass(frozen=True, eq=False)
class RobotRecording:
    """One experiment on a robot, sampled uniformly; arrays are read-only and in SI.

    time (N,) [s]; joints: names of the J recorded joints in the order of the model; command, angle, second_angle (N, J) [rad
    | m],
    torque (N, J) as the actuator gives it, before its gear [N m | N], velocity (N, J) [rad/s | m/s], current (N, J) [A]: None
    where no joint has the channel, a column of NaN where one joint lacks it. hold: how the input goes between samples (held,
    linear, mean); payload: a known point mass; held_at: joints of the model that are not in the log, with their position;
    notes: what reading guessed or changed; hold_stated: whether a binding states the hold.

    >>> import numpy as np
    >>> t = np.arange(4) * 0.01
    >>> log = RobotRecording(t, ("shoulder", "elbow"), 0.01, angle=np.zeros((4, 2)), torque=np.ones((4, 2)))
    >>> log.has("torque", "elbow"), log.has("command", "elbow")
    (True, False)
    """

    time: np.ndarray
    joints: tuple[str, ...]
    dt: float
    angle: np.ndarray
    torque: np.ndarray | None = None
    command: np.ndarray | None = None
    velocity: np.ndarray | None = None
    current: np.ndarray | None = None
    second_angle: np.ndarray | None = None
    source: str = "memory"
    sha256: str = ""
    hold: str = "held"
    payload: Payload | None = None
    held_at: tuple[tuple[str, float], ...] = ()
    notes: tuple[str, ...] = ()
    hold_stated: bool = False

    def __post_init__(self) -> None:
        n, j = len(self.time), len(self.joints)
        for name, shape in (("time", (n,)), *((c, (n, j)) for c in CHANNELS)):
            array = getattr(self, name)
            if array is None:
                continue
            array = np.array(array, float)
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}; expected {shape}")
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.time)

    def has(self, channel: str, joint: str) -> bool:
        """Whether a joint has a channel."""
        array = getattr(self, channel)
        return array is not None and joint in self.joints and bool(np.isfinite(array[0, self.joints.index(joint)]))

    def positions(self, robot: Robot) -> np.ndarray:
        """Position (N, m) of every independent joint of the robot; those that are not in the log stay where they are held."""
        held = dict(self.held_at)
        return np.column_stack(
            [
                self.angle[:, self.joints.index(name)] if name in self.joints else np.full(len(self), held[name])
                for name in robot.joints
            ]
        )


def joints_named(path: Path) -> tuple[str, ...]:
    """Joints of which a recording's columns speak by the default names; () for a file that is not there or not readable."""
    try:
        return joints_in_table(read_table(path)) if is_source(path) else ()
    except InputError:
        return ()


def joints_in_table(columns: Iterable[str]) -> tuple[str, ...]:
    """Joints of which columns speak by the default names."""
    return tuple(dict.fromkeys(m["joint"] for m in map(_COLUMN.match, columns) if m))


def load_robot_recording(
    path: str | Path, robot: Robot, *, model: str | Path | None = None, checked: bool = True
) -> RobotRecording:
    """Read a recording of a robot; the binding is looked for beside it and beside ``model``.

    ``checked``: whether stamps, limits and the assignment of commands are checked; without it they are left to the caller.

    Raises InputError naming the file, the joint or row, what was expected and what to do: a joint that the model does not have,
    sampling that is not uniform, a position outside the joint's limits, a command and a position of different joints swapped.
    """
    path = Path(path)
    need_source(path)
    binding = find_robot_binding(path, Path(model) if model else None)
    return robot_from_table(path, read_table(path), binding, robot, sha256=digest(path), checked=checked)


def robot_from_table(
    path: Path, table: Table, binding: RobotBinding | None, robot: Robot, *, sha256: str = "", checked: bool = True
) -> RobotRecording:
    """The recording that a table of columns holds, as `load_robot_recording` reads it; ``path``: how messages name the source."""
    notes = list(table.notes)
    if binding is not None and binding.unused:
        notes.append(f"[experiment] {', '.join(binding.unused)}: not used of a robot, whose gains are fitted by joint.")
    given = binding.joints if binding is not None and binding.joints else _by_name(path, table, robot, notes)
    _known(path if binding is None else binding.source, tuple(given), robot)
    names = tuple(j for j in robot.joints if j in given)
    arrays = _arrays(path, table, given, names)
    count = len(next(iter(arrays.values())))
    time, jitter = _time(path, table, binding, count), 0.0 if binding is None else binding.jitter
    time, note = unrounded(time)
    notes += [note] if note else []
    dt = sample_time(path, time, jitter, uniform=checked)
    if jitter and off_by(time, dt, gaps=False) <= jitter:
        time, arrays, told = _resampled(time, arrays, binding.hold if binding else "held", dt)
        notes += told
    matrices: dict[str, np.ndarray] = {}
    for channel in CHANNELS:
        if any((name, channel) in arrays for name in names):
            empty = np.full(count, np.nan)
            matrices[channel] = np.column_stack([arrays.get((name, channel), empty) for name in names])
    lacking = [name for name in names if (name, "angle") not in arrays]
    if lacking:
        raise InputError(path, f"joint {lacking[0]!r} has no position", "an angle of every joint that is recorded", "add it")
    held = tuple((j, _held_position(robot, k)) for k, j in enumerate(robot.joints) if j not in names)
    if binding is not None and binding.payload is not None:
        robot.link_of(binding.payload.body)
    recording = RobotRecording(
        time, names, dt, source=path.name,
        sha256=sha256,
        hold=binding.hold if binding else "held", payload=binding.payload if binding else None, held_at=held, notes=tuple(notes),
        hold_stated=binding is not None and binding.hold_stated, **matrices,
    )  # fmt: skip
    if checked:
        _within_limits(path, recording, robot)
        _not_swapped(path, recording)
    return recording


def _resampled(
    time: np.ndarray, arrays: dict[tuple[str, str], np.ndarray], hold: str, dt: float
) -> tuple[np.ndarray, dict[tuple[str, str], np.ndarray], list[str]]:
    """Channels at jittered stamps on the uniform grid, as `mjsim.timebase.resample` puts them there, and a note."""
    out, told, grid = {}, "", time
    for (name, channel), values in arrays.items():
        done, told = resample({"time": time, channel: values}, hold, dt)
        out[name, channel], grid = done[channel], done["time"]
    return grid, out, [told] if told else []


def _by_name(path: Path, table: Table, robot: Robot, notes: list[str]) -> dict[str, dict[str, tuple[str, float, int | None]]]:
    """The default columns: channel -> (column, factor, row), by joint.

    A log that names joints by itself (`Table.by_joint`) has SI of the joint's kind, and may hold joints that the model lacks.
    """
    given: dict[str, dict[str, tuple[str, float, int | None]]] = {}
    for column in table:
        match = _COLUMN.match(column)
        if not match:
            continue
        name, channel, unit = match["joint"], match["channel"], match["unit"]
        if name in robot.joints:
            expected = SUFFIXES[robot.motions[robot.joints.index(name)]][channel]
            if unit != expected and not table.by_joint:
                raise InputError(path, f"column {column!r} of a {robot.motions[robot.joints.index(name)].value} joint",
                                 f"{name}.{channel}_{expected}", "correct the unit")  # fmt: skip
        given.setdefault(name, {})[channel] = (column, 1.0, None)
    if table.by_joint and set(given) & set(robot.joints) and (others := sorted(set(given) - set(robot.joints))):
        notes.append(f"Joints that the model does not have are left out: {', '.join(others)}.")
        given = {name: channels for name, channels in given.items() if name in robot.joints}
    if tied := [name for name in given if name in robot.dofs and name not in robot.joints]:
        notes.append(f"Joints that an equality ties to others follow these; their columns are left out: {', '.join(tied)}.")
        given = {name: channels for name, channels in given.items() if name not in tied}
    if not given:
        raise InputError(
            path, "no column of a joint", f"columns such as {robot.joints[0]}.angle_rad",
            table.hint or f"rename them, or bind them by [joints.{robot.joints[0]}] in {path.with_suffix('.toml').name}",
        )  # fmt: skip
    return given


def _known(where: object, given: Sequence[str], robot: Robot) -> None:
    for name in given:
        if name not in robot.joints:
            raise InputError(
                where, f"joint {name!r} is not in the model", f"one of {', '.join(robot.joints)}",
                nearest(name, robot.joints, "correct the name"),
            )  # fmt: skip


def _arrays(
    path: Path,
    table: Mapping[str, np.ndarray],
    given: Mapping[str, Mapping[str, tuple[str, float, int | None]]],
    names: Sequence[str],
) -> dict[tuple[str, str], np.ndarray]:
    """Channels (N,) in SI by (joint, channel)."""
    out: dict[tuple[str, str], np.ndarray] = {}
    for name in names:
        for channel, (column, factor, row) in given[name].items():
            if column not in table:
                raise InputError(
                    path,
                    f"no column {column!r} for {name}.{channel}",
                    f"one of {', '.join(table)}",
                    nearest(column, table, "bind it"),
                )
            array = table[column]
            if row is not None:
                if array.ndim != 2 or not 0 <= row < array.shape[0]:
                    raise InputError(path, f"row {row} of {column!r} with shape {array.shape}", "a row of a matrix", "correct it")
                array = array[row]
            if array.ndim != 1:
                raise InputError(path, f"{column!r} has shape {array.shape}", "one value per sample", "name a row")
            out[name, channel] = array * factor
            need_numbers(path, f"{name}.{channel}", out[name, channel])
    lengths = {key: len(a) for key, a in out.items()}
    first = next(iter(lengths.values()))
    for (name, channel), length in lengths.items():
        if length != first:
            raise InputError(path, f"{name}.{channel} has {length} samples, others {first}", "equal lengths", "cut them alike")
    return out


def _time(path: Path, table: Mapping[str, np.ndarray], binding: RobotBinding | None, count: int) -> np.ndarray:
    if binding is not None and binding.dt:
        return binding.dt * np.arange(count)
    column, factor = binding.time if binding is not None and binding.time else ("time_s", 1.0)
    if column not in table or table[column].shape != (count,):
        raise InputError(path, f"no time column {column!r} of {count} samples", "time, or [recording] dt", "add or bind it")
    return np.asarray(table[column] * factor)


def _held_position(robot: Robot, joint: int) -> float:
    return float(robot.model.qpos0[robot.leading(joint)])


def _within_limits(path: Path, r: RobotRecording, robot: Robot) -> None:
    for k, name in enumerate(r.joints):
        low, high = robot.ranges[robot.dofs.index(name)]
        slack = BEYOND * (high - low) if np.isfinite(high - low) else 0.0
        out = np.flatnonzero((r.angle[:, k] < low - slack) | (r.angle[:, k] > high + slack))
        if len(out):
            raise InputError(
                path, f"{name} is at {r.angle[out[0], k]:.4g} in {where_in(path, int(out[0]))}",
                f"{low:.4g} to {high:.4g}, the joint's range",
                "check its zero and unit, or correct the range in the model",
            )  # fmt: skip


def _not_swapped(path: Path, r: RobotRecording) -> None:
    """Refuse commands that go with the position of another joint: correlation of their changes, over all pairs."""
    if r.command is None or len(r.joints) < 2:
        return
    C = _correlations(r.command, r.angle)
    for j, k in zip(*np.nonzero(np.triu(np.ones_like(C), 1)), strict=True):
        crossed = min(C[j, k], C[k, j])
        if crossed > ALIKE and max(C[j, j], C[k, k]) < UNLIKE:
            raise InputError(
                path, f"the command of {r.joints[j]} goes with the position of {r.joints[k]} and the other way round "
                f"(correlation {crossed:.2f}, their own {max(C[j, j], C[k, k]):.2f})", "command and position of the same joint",
                "swap the columns",
            )  # fmt: skip


def _correlations(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Correlation (J, J) of every column of x (N, J) with every one of y (N, J); 0 for what does not vary or is not there."""

    def unit(a: np.ndarray) -> np.ndarray:
        a = np.nan_to_num(a) - np.nan_to_num(a).mean(axis=0)
        size = np.linalg.norm(a, axis=0)
        return np.where(size > 1e-12, a / np.maximum(size, 1e-300), 0.0)

    return np.asarray(unit(x).T @ unit(y))
