"""Tables that are too long for memory, read window by window: CSV, NPZ and Parquet.

A window is a `Table` of its own, so that a binding applies to it as to a whole file.
"""

from __future__ import annotations

import csv
import itertools
import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from mjsim.errors import InputError
from mjsim.readers.optional import need
from mjsim.readers.table import Table, first_line
from mjsim.readers.text import form_of

__all__ = ["row_count", "windows"]

PROBE = 2**20  # bytes of a CSV from which the length of its rows is told


def row_count(path: Path) -> int | None:
    """How many rows a file holds, without reading them: estimated for CSV, None for a format that is read as a whole.

    None as well for a file that is damaged: its reader says so.
    """
    try:
        match path.suffix.lower():
            case ".parquet":
                return int(need("pyarrow.parquet", path).ParquetFile(str(path)).metadata.num_rows)
            case ".npz":
                return max((shape[0] for shape, _ in _headers(path).values() if len(shape) == 1), default=None)
            case ".csv":
                return _csv_rows(path)
    except InputError:
        raise
    except Exception:
        return None
    return None


def windows(path: Path, rows: int) -> Iterator[tuple[int, Table]]:
    """(first row, table) of windows of ``rows`` rows, one after the other; the last one may be shorter.

    Raises InputError for a file that cannot be read further, with the row at which that is.
    """
    start = 0
    try:
        for arrays in {".parquet": _parquet, ".npz": _npz, ".csv": _csv}[path.suffix.lower()](path, rows):
            yield start, Table.of(arrays)
            start += len(next(iter(arrays.values())))
    except InputError:
        raise
    except Exception as error:  # of the libraries that read: they name no common type
        raise InputError(
            path, f"not readable from row {start + 1} on ({first_line(error)})", "numbers", "record it again"
        ) from None


def _parquet(path: Path, rows: int) -> Iterator[dict[str, np.ndarray]]:
    arrow = need("pyarrow", path)
    file = need("pyarrow.parquet", path).ParquetFile(str(path), pre_buffer=False)
    names = [f.name for f in file.schema_arrow if arrow.types.is_integer(f.type) or arrow.types.is_floating(f.type)]
    # one row group at a time: the iterator over all of them keeps what it has read
    groups = (b for g in range(file.num_row_groups) for b in file.iter_batches(batch_size=rows, row_groups=[g], columns=names))
    for batch in _even(groups, rows, arrow):
        yield {n: np.asarray(batch.column(n).to_numpy(), float) for n in names}


def _even(batches: Iterator[Any], rows: int, arrow: Any) -> Iterator[Any]:
    """Batches of equal length: those of the file end where its row groups end."""
    kept: list[Any] = []
    count = 0
    for batch in batches:
        kept.append(batch)
        count += batch.num_rows
        if count < rows:
            continue
        table = arrow.Table.from_batches(kept)
        first = 0
        while count - first >= rows:
            yield table.slice(first, rows)
            first += rows
        kept, count = table.slice(first).to_batches(), count - first
    if count:
        yield arrow.Table.from_batches(kept)


def _headers(path: Path) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    """Shape and type of each numeric array of an archive, from its header."""
    found = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            if member.endswith(".npy"):
                with archive.open(member) as stream:
                    shape, _, kind = _header(path, member, stream)
                if kind.kind in "fiub":
                    found[member.removesuffix(".npy")] = (shape, kind)
    return found


def _header(path: Path, member: str, stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(npy.read_magic(stream))
    if read is None:
        raise InputError(path, f"{member!r} has an unknown NPY version", "1.0 or 2.0", "save it with numpy.savez")
    return read(stream)


def _npz(path: Path, rows: int) -> Iterator[dict[str, np.ndarray]]:
    headers = _headers(path)
    longest = max((shape[0] for shape, _ in headers.values() if len(shape) == 1), default=0)
    names = [n for n, (shape, _) in headers.items() if shape == (longest,)]
    with ExitStack() as stack:
        archive = stack.enter_context(zipfile.ZipFile(path))
        streams = {n: stack.enter_context(archive.open(f"{n}.npy")) for n in names}
        for name, stream in streams.items():
            _header(path, name, stream)
        for first in range(0, longest, rows):
            count = min(rows, longest - first)
            yield {n: _values(streams[n], headers[n][1], count) for n in names}


def _values(stream: IO[bytes], kind: np.dtype, count: int) -> np.ndarray:
    data = stream.read(count * kind.itemsize)
    if len(data) < count * kind.itemsize:
        raise ValueError("the file ends early")
    return np.frombuffer(data, kind).astype(float)


def _csv_rows(path: Path) -> int:
    """The number of rows, from the mean length of the first ones where the file is long."""
    size = path.stat().st_size
    with path.open("rb") as handle:
        probe = handle.read(PROBE)
    lines = probe.count(b"\n") - 1
    return lines if size <= PROBE else math.ceil(size / len(probe) * lines)


def _csv(path: Path, rows: int) -> Iterator[dict[str, np.ndarray]]:
    with path.open(newline="", encoding="utf-8-sig") as handle:
        by, comma = form_of(handle.readline(), handle.readline())
        handle.seek(0)
        names = [h.strip() for h in next(csv.reader(handle, delimiter=by), [])]
        while lines := list(itertools.islice(handle, rows)):
            if comma:
                lines = [line.replace(",", ".") for line in lines]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of empty lines at the end
                data = np.loadtxt(lines, delimiter=by, ndmin=2, comments=None, quotechar='"')
            if data.size == 0:
                return
            if data.shape[1] != len(names):
                raise ValueError(f"{data.shape[1]} columns under {len(names)} names")
            yield {n: data[:, i].copy() for i, n in enumerate(names)}
