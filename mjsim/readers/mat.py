"""MATLAB files; those of version 7.3 are HDF5 (`mjsim.readers.hdf5`)."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.hdf5 import SIGNATURE, read_mat73
from mjsim.readers.table import MOST_BYTES, Table, need_size

__all__ = ["read_mat"]

RATIO = 1032  # most bytes that one compressed byte of a deflate stream can give
BLOCK = 512  # bytes ahead of the HDF5 of a version 7.3 file
HEADER, COMPRESSED = 128, 15  # bytes of a version 5 header; tag of a compressed element


def read_mat(path: Path) -> Table:
    """Numeric arrays of one or two dimensions, fields of structs as ``name.field``."""
    if _is_hdf5(path):
        return read_mat73(path)
    from scipy.io import loadmat

    _need_memory(path)
    try:
        content = loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except NotImplementedError as error:
        raise InputError(path, f"not a readable MAT file ({error})", "MATLAB v4 to v7.3", "save it with -v7") from None
    table: dict[str, np.ndarray] = {}

    def add(name: str, value: Any, depth: int) -> None:
        if hasattr(value, "_fieldnames") and depth < 20:
            for field in value._fieldnames:
                add(f"{name}.{field}" if name else field, getattr(value, field), depth + 1)
            return
        array = np.asarray(value)
        if array.dtype.kind in "fiub" and array.ndim in (1, 2) and array.size > 1:
            table[name] = array.astype(float)

    for name, value in content.items():
        if not name.startswith("__"):
            add(name, value, 0)
    return Table.of(table)


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
