"""NumPy archives."""

from __future__ import annotations

import math
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from mjsim.errors import InputError
from mjsim.readers.table import Table, need_size

__all__ = ["read_npz"]


def read_npz(path: Path) -> Table:
    """Numeric arrays of one or two dimensions, of which only the headers are read at first. No pickled object is read."""
    shapes: dict[str, tuple[int, ...]] = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            if not member.endswith(".npy"):
                continue
            with archive.open(member) as stream:
                read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(npy.read_magic(stream))
                if read_header is None:
                    raise InputError(path, f"{member!r} has an unknown NPY version", "1.0 or 2.0", "save it with numpy.savez")
                shape, _, dtype = read_header(stream)
            if dtype.kind in "fiub" and len(shape) in (1, 2):
                shapes[member.removesuffix(".npy")] = shape
    return Table(shapes, {name: partial(_member, path, name, shape) for name, shape in shapes.items()})


def _member(path: Path, name: str, shape: tuple[int, ...]) -> np.ndarray:
    need_size(path, name, 8.0 * math.prod(shape))
    with np.load(path, allow_pickle=False) as content:
        return np.asarray(content[name]).astype(float)
