"""One entry for all formats: the reader by the suffix, and one clear line for whatever a damaged file raises."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.lerobot import read_lerobot
from mjsim.readers.mat import read_mat
from mjsim.readers.mcap import read_mcap
from mjsim.readers.npz import read_npz
from mjsim.readers.parquet import read_parquet
from mjsim.readers.ros import read_bag, read_db3
from mjsim.readers.sage import read_sage
from mjsim.readers.source import files_of, is_source, part_of, suffix_of
from mjsim.readers.table import Table, first_line
from mjsim.readers.text import read_csv

__all__ = ["READERS", "read_table"]

T = TypeVar("T")

READERS: dict[str, Callable[[Path], Table]] = {
    ".csv": read_csv,
    ".mat": lambda path: read_mat(*part_of(path)),
    ".npz": read_npz,
    ".parquet": read_parquet,
    ".mcap": read_mcap,
    ".bag": read_bag,
    ".db3": read_db3,
    "lerobot": lambda path: read_lerobot(*part_of(path)),
    "rosbag2": lambda path: _rosbag2(path),
    "sage": read_sage,
}
"""Reader by the ending of a file, or by the form of a folder (`mjsim.readers.source`)."""
FORMATS = {
    ".csv": "comma-separated values",
    ".mat": "MATLAB v4 to v7.3",
    ".npz": "numpy.savez",
    ".parquet": "Parquet",
    ".mcap": "MCAP",
    ".bag": "a ROS 1 bag",
    ".db3": "SQLite of rosbag2",
    "lerobot": "a LeRobot data set of version 2 or 3",
    "rosbag2": "a rosbag2 recording",
    "sage": "the CSV form of SAGE",
}


def read_table(path: Path) -> Table:
    """Every numeric column of a file, or of a folder of a known form, by its name; matrices keep their shape (rows, samples).

    Raises InputError for a file that is no regular file, is empty, damaged or of an unknown format, or holds no numeric column.
    """
    if not is_source(path):
        raise InputError(path, "not a regular file", "a recording", "name a file")
    if path.is_file() and path.stat().st_size == 0:
        raise InputError(path, "the file is empty", "a recording", "record it again")
    suffix = suffix_of(path)
    if suffix not in READERS:
        choices = ", ".join(s for s in READERS if s.startswith("."))
        raise InputError(path, f"unknown kind of file {path.suffix!r}", f"one of {choices}", "convert it")
    table = _guarded(path, suffix, lambda: READERS[suffix](path))
    if not table:
        raise InputError(path, "no numeric column", "at least time, torque and one output", "check the file")
    loaders = {name: _column(path, suffix, table, name) for name in table}
    return Table(table.shapes, loaders, table.notes, by_joint=table.by_joint, hint=table.hint)


def _rosbag2(folder: Path) -> Table:
    """The one file of a rosbag2 recording."""
    files = files_of(folder)
    if len(files) != 1:
        raise InputError(folder, f"it holds {len(files)} files", "one .db3 or .mcap", "name one, or convert it to one")
    return read_db3(files[0]) if files[0].suffix == ".db3" else read_mcap(files[0])


def _column(path: Path, suffix: str, table: Table, name: str) -> Callable[[], np.ndarray]:
    return lambda: _guarded(path, suffix, lambda: table[name])


def _guarded(path: Path, suffix: str, read: Callable[[], T]) -> T:
    """What a reader returns; InputError for any error of the libraries behind it, which name no common type."""
    try:
        return read()
    except InputError:
        raise
    except MemoryError as error:
        told = f"not enough memory to read it ({first_line(error)})"
        raise InputError(
            path, told, "less than the memory there is", "read a part of it, or record it again if it is damaged"
        ) from None
    except (Exception, RecursionError) as error:
        kind = FORMATS[suffix]
        told = f"not a readable {suffix.removeprefix('.').upper()} file ({first_line(error)})"
        raise InputError(path, told, kind, "name it by its true format, or record it again") from None
