"""MATLAB files; those of version 7.3 are HDF5 (`mjsim.readers.hdf5`)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.hdf5 import SIGNATURE, read_mat73
from mjsim.readers.mat_elements import check_elements
from mjsim.readers.table import MOST_BYTES, Table, need_size

__all__ = ["read_mat"]

RATIO = 1032  # most bytes that one compressed byte of a deflate stream can give
DEPTH = 20  # structs inside structs that are read
BLOCK = 512  # bytes ahead of the HDF5 of a version 7.3 file
HEADER, COMPRESSED = 128, 15  # bytes of a version 5 header; tag of a compressed element


def read_mat(path: Path, experiment: int | None = None) -> Table:
    """Numeric arrays of one or two dimensions, fields of structs as ``name.field``.

    ``experiment`` (from 1) chooses an element of every array of structs and of every cell array of numbers, which are left out
    without it. Raises InputError for a number beyond them, and where the file holds nothing else and none is chosen.
    """
    if _is_hdf5(path):
        if experiment is not None:
            raise InputError(path, "experiments of version 7.3 are not read apart", "version 7", "save it with -v7")
        return read_mat73(path)
    from scipy.io import loadmat

    _need_memory(path)
    check_elements(path)
    try:
        content = loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except NotImplementedError as error:
        raise InputError(path, f"not a readable MAT file ({error})", "MATLAB v4 to v7.3", "save it with -v7") from None
    columns = _Columns({}, [], experiment)
    for name, value in content.items():
        if not name.startswith("__"):
            columns.add(name, value, 0)
    _need_one(path, columns, content)
    return Table.of(columns.table)


@dataclass(frozen=True)
class _Columns:
    """Columns by name, found so far; counts: elements of each array of experiments; chosen: number of the one that is read."""

    table: dict[str, np.ndarray]
    counts: list[int]
    chosen: int | None

    def add(self, name: str, value: Any, depth: int) -> None:
        """Add what a value of the file holds."""
        if hasattr(value, "_fieldnames") and depth < DEPTH:
            for field in value._fieldnames:
                self.add(f"{name}.{field}" if name else field, getattr(value, field), depth + 1)
            return
        array = np.asarray(value)
        if array.dtype.kind in "fiub" and array.ndim in (1, 2) and array.size > 1:
            self.table[name] = array.astype(float)
        elif array.dtype == object and array.ndim == 1 and depth < DEPTH and all(map(_is_experiment, array)):
            self.counts.append(len(array))
            if self.chosen is not None and 1 <= self.chosen <= len(array):
                self.add(name, array[self.chosen - 1], depth + 1)


def _is_experiment(item: Any) -> bool:
    """Whether an element of an array is a struct or an array of numbers."""
    return hasattr(item, "_fieldnames") or (isinstance(item, np.ndarray) and item.dtype.kind in "fiub" and item.size > 1)


def _need_one(path: Path, columns: _Columns, content: Mapping[str, Any]) -> None:
    """Raise InputError where the choice of an experiment does not fit the file, or only MATLAB can read what it holds."""
    count = max(columns.counts, default=0)
    if columns.chosen is not None and not 1 <= columns.chosen <= count:
        held = f"{count} experiments" if count else "no array of structs and no cell array"
        raise InputError(
            path, f"experiment {columns.chosen} is chosen, and it holds {held}", f"#1 to #{count}" if count else path.name,
            "correct the number behind #" if count else "leave the number out",
        )  # fmt: skip
    if columns.table:
        return
    if count:
        raise InputError(
            path, f"it holds {count} experiments", "one that is chosen", f"name {path.name}#1 to {path.name}#{count}"
        )
    if any(type(value).__name__ == "MatlabOpaque" for value in content.values()):
        raise InputError(
            path, "it holds an object of a MATLAB class (iddata, timeseries, table)", "arrays or structs",
            "save its signals as arrays in MATLAB",
        )  # fmt: skip


def _is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5: at its start, or behind the 512 bytes in which MATLAB states its version."""
    with path.open("rb") as handle:
        head = handle.read(BLOCK + len(SIGNATURE))
    return head.startswith(SIGNATURE) or head[BLOCK:] == SIGNATURE


def _need_memory(path: Path) -> None:
    """Refuse a file whose compressed elements give more than `MOST_BYTES`, without keeping what they give."""
    size = path.stat().st_size
    if size * RATIO <= MOST_BYTES:
        return
    total = 0
    with path.open("rb") as handle:
        header = handle.read(HEADER)
        order = "<" if header[126:128] == b"IM" else ">"
        while len(tag := handle.read(8)) == 8:
            kind, count = struct.unpack(f"{order}II", tag)
            if kind != COMPRESSED:
                total += count
                handle.seek(count, 1)
                continue
            total += _inflated(handle.read(count))
            need_size(path, "the file", total)


def _inflated(data: bytes) -> int:
    """Bytes that a deflate stream gives, at most a little more than `MOST_BYTES`."""
    stream, total = zlib.decompressobj(), 0
    while data and not stream.eof and total <= MOST_BYTES:
        total += len(stream.decompress(data, 2**20))
        data = stream.unconsumed_tail
    return total
