"""One entry for all formats: the reader by the suffix, and one clear line for whatever a damaged file raises."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.mat import read_mat
from mjsim.readers.mcap import read_mcap
from mjsim.readers.npz import read_npz
from mjsim.readers.parquet import read_parquet
from mjsim.readers.table import Table, first_line
from mjsim.readers.text import read_csv

__all__ = ["READERS", "read_table"]

T = TypeVar("T")

READERS: dict[str, Callable[[Path], Table]] = {
    ".csv": read_csv,
    ".mat": read_mat,
    ".npz": read_npz,
    ".parquet": read_parquet,
    ".mcap": read_mcap,
}
FORMATS = {
    ".csv": "comma-separated values",
    ".mat": "MATLAB v4 to v7",
    ".npz": "numpy.savez",
    ".parquet": "Parquet",
    ".mcap": "MCAP",
}


def read_table(path: Path) -> Table:
    """Every numeric column of a file by its name; matrices keep their shape (rows, samples).

    Raises InputError for a file that is no regular file, is empty, damaged or of an unknown format, or holds no numeric column.
    """
    if not path.is_file():
        raise InputError(path, "not a regular file", "a recording", "name a file")
    if path.stat().st_size == 0:
        raise InputError(path, "the file is empty", "a recording", "record it again")
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise InputError(path, f"unknown kind of file {path.suffix!r}", f"one of {', '.join(READERS)}", "convert it")
    table = _guarded(path, suffix, lambda: READERS[suffix](path))
    if not table:
        raise InputError(path, "no numeric column", "at least time, torque and one output", "check the file")
    return Table(table.shapes, {name: _column(path, suffix, table, name) for name in table})


def _column(path: Path, suffix: str, table: Table, name: str) -> Callable[[], np.ndarray]:
    return lambda: _guarded(path, suffix, lambda: table[name])


def _guarded(path: Path, suffix: str, read: Callable[[], T]) -> T:
    """What a reader returns; InputError for any error of the libraries behind it, which name no common type."""
    try:
        return read()
    except InputError:
        raise
    except (Exception, MemoryError, RecursionError) as error:
        kind = FORMATS[suffix]
        told = f"not a readable {suffix.removeprefix('.').upper()} file ({first_line(error)})"
        raise InputError(path, told, kind, "name it by its true format, or record it again") from None
