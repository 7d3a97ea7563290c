"""`load`: a recording from a file, from arrays, or from a pandas table."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from mjsim.binding import Binding
from mjsim.control import as_driven
from mjsim.errors import InputError
from mjsim.mjcf import carried_binding, load_model
from mjsim.readers import Table, digest, need_source, read_table
from mjsim.recording import Recording, find_binding, from_table
from mjsim.recording import load as load_file
from mjsim.robot.binding import RobotBinding, find_robot_binding
from mjsim.robot.recording import RobotRecording, load_robot_recording, robot_from_table
from simgap.api.model import Model
from simgap.robot import is_robot

__all__ = ["Frame", "load", "loaded"]

TABLES = ("recording", "joints", "experiment")


class Frame(Protocol):
    """Columns by name that are no mapping: a pandas DataFrame."""

    def keys(self) -> Iterable[Any]:
        """Names of the columns."""

    def __getitem__(self, name: Any, /) -> Any:
        """A column."""


def load(
    source: str | Path | Mapping[str, ArrayLike] | Frame,
    *,
    model: Model | str | Path | mujoco.MjSpec | None = None,
    binding: Mapping[str, Any] | None = None,
    joint: str | None = None,
    name: str = "memory",
) -> Recording | RobotRecording:
    """Read a recording.

    ``source``: a file (CSV, MAT, NPZ, Parquet, MCAP, ...; see the formats), or columns by name: a mapping of arrays, or a pandas
    DataFrame. ``model``: whose TOML file may name the columns; of a robot, all joints are read. ``binding``: which column is
    what, with the tables of such a TOML file, or those of ``[recording]`` alone; without it the columns have their default names
    (``time_s``, ``torque_Nm``, ``velocity_rad_s``, ``angle_rad``). ``joint``: which one of a log that holds several. ``name``:
    what reports call data from memory. Raises `InputError` naming the column or row, what was expected and what to do.

    >>> import numpy as np
    >>> import simgap
    >>> t = np.arange(0, 2, 0.004)
    >>> log = {"t": 1e3 * t, "u": np.sin(3 * t), "speed": np.cos(2 * t)}
    >>> recording = simgap.load(log, binding={
    ...     "time": {"column": "t", "unit": "ms"}, "torque": "u", "velocity": {"column": "speed", "unit": "rpm"}})
    >>> len(recording), recording.dt
    (500, 0.004)
    >>> float(recording.velocity[0].round(4))  # rad/s
    0.1047
    """
    where = None if model is None else Model(model)
    if isinstance(source, str | Path):
        return _from_file(Path(source), where, binding, joint)
    return _from_columns(source, where, binding, joint, name)


def loaded(
    source: Any, model: Model, *, joint: str | None = None, robot: bool = False, uniform: bool = True
) -> Recording | RobotRecording:
    """What stands for a recording of a model, as one: itself where it is loaded already."""
    if isinstance(source, RobotRecording):
        return source
    if isinstance(source, Recording):
        return source if robot else as_driven(model.axis.chain, source)
    if not isinstance(source, str | Path):
        return _from_columns(source, model, None, joint, "memory", robot=robot)
    path = Path(source)
    if robot:
        return load_robot_recording(path, model.robot, model=model.path)
    own = load_model(model.path)
    prefer = own.axis.chain.bodies[0].joint
    carried = carried_binding(own, path)
    chain = own.axis.chain
    return as_driven(
        chain,
        load_file(
            path, model=model.path, binding=carried, joint=joint, prefer=prefer, uniform=uniform, driven=chain.driven
        ),
    )  # fmt: skip


def _from_file(
    path: Path, model: Model | None, binding: Mapping[str, Any] | None, joint: str | None
) -> Recording | RobotRecording:
    if binding is None:
        if model is None:
            return load_file(path, joint=joint)
        return loaded(path, model, joint=joint, robot=is_robot([path], model.path))
    need_source(path)
    return _bound(path, read_table(path), _tables(binding), model, joint, digest(path), robot=False)


def _from_columns(
    source: Any, model: Model | None, binding: Mapping[str, Any] | None, joint: str | None, name: str, *, robot: bool = False
) -> Recording | RobotRecording:
    if not (hasattr(source, "keys") and hasattr(source, "__getitem__")):
        raise InputError(
            "recording", f"a {type(source).__name__}", "a file, a mapping of arrays, a pandas DataFrame or a Recording",
            "give the columns by name",
        )  # fmt: skip
    arrays = {str(key): _column(str(key), source[key]) for key in source.keys()}  # noqa: SIM118  (a DataFrame is no mapping)
    content = hashlib.sha256()
    for key, array in arrays.items():
        content.update(key.encode())
        content.update(np.ascontiguousarray(array).tobytes())
    tables = None if binding is None else _tables(binding)
    return _bound(Path(name), Table.of(arrays), tables, model, joint, content.hexdigest(), robot=robot)


def _bound(
    path: Path, table: Table, tables: Mapping[str, Any] | None, model: Model | None, joint: str | None, sha256: str, *,
    robot: bool,
) -> Recording | RobotRecording:  # fmt: skip
    """The recording of a table: of all joints where the model is a robot, else of one."""
    beside = None if model is None else model.path
    if model is not None and (robot or is_robot([dict.fromkeys(table)], model.path)):
        bound = find_robot_binding(path, beside) if tables is None else RobotBinding.from_tables(tables, Path("binding"))
        return robot_from_table(path, table, bound, model.robot, sha256=sha256)
    own = find_binding(path, beside) if tables is None else Binding.from_tables(tables, Path("binding"))
    if model is None:
        return from_table(path, table, own or Binding.default(), joint=joint, sha256=sha256)
    chain = model.axis.chain
    return as_driven(
        chain,
        from_table(
            path, table, own or Binding.default(), joint=joint, prefer=chain.bodies[0].joint, sha256=sha256, driven=chain.driven
        ),
    )


def _tables(binding: Mapping[str, Any]) -> Mapping[str, Any]:
    """The tables of a binding; those of ``[recording]`` may stand alone."""
    return binding if set(binding) & set(TABLES) else {"recording": dict(binding)}


def _column(name: str, values: Any) -> np.ndarray:
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError):
        raise InputError("recording", f"column {name!r} holds no numbers", "numbers", "convert or leave it out") from None
