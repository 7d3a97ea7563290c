"""NumPy archives."""

from __future__ import annotations

import math
import zipfile
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from mjsim.errors import InputError
from mjsim.readers.dof import NAMES, dof_table, is_dof
from mjsim.readers.table import Table, need_size

__all__ = ["read_npz"]

MOST_NAMES, MOST_TEXT = 1000, 4096  # joints, and bytes of a name


def read_npz(path: Path) -> Table:
    """Numeric arrays of one or two dimensions, of which only the headers are read at first. No pickled object is read.

    Those of ``time``, ``dof_pos``, ``des_dof_pos`` (N, J) become columns by joint (`mjsim.readers.dof`).
    """
    shapes: dict[str, tuple[int, ...]] = {}
    texts: dict[str, tuple[int, ...]] = {}
    with zipfile.ZipFile(path) as archive:
        if len(set(archive.namelist())) < len(archive.namelist()):
            twice = next(name for name, count in Counter(archive.namelist()).items() if count > 1)
            raise InputError(path, f"it holds {twice!r} twice", "one array of a name", "save it with numpy.savez")
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
            elif dtype.kind == "U" and len(shape) == 1 and shape[0] <= MOST_NAMES and dtype.itemsize <= MOST_TEXT:
                texts[member.removesuffix(".npy")] = shape
    if is_dof(shapes):
        return dof_table(shapes, lambda name: _member(path, name, shapes[name]), _names(path, texts))
    return Table(shapes, {name: partial(_member, path, name, shape) for name, shape in shapes.items()})


def _names(path: Path, texts: Mapping[str, tuple[int, ...]]) -> list[str] | None:
    """Names of the joints that the archive states."""
    member = next((n for n in NAMES if n in texts), None)
    if member is None:
        return None
    with np.load(path, allow_pickle=False) as content:
        return [str(name) for name in content[member]]


def _member(path: Path, name: str, shape: tuple[int, ...]) -> np.ndarray:
    need_size(path, name, 8.0 * math.prod(shape))
    with np.load(path, allow_pickle=False) as content:
        return np.asarray(content[name]).astype(float)
