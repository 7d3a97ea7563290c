"""MATLAB files of version 7.3, which are HDF5."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mjsim.readers.optional import need
from mjsim.readers.table import Table, need_size

__all__ = ["SIGNATURE", "read_mat73"]

SIGNATURE = b"\x89HDF\r\n\x1a\n"
DEPTH = 20


def read_mat73(path: Path) -> Table:
    """Numeric arrays, fields of structs as ``name.field``; each is read when it is asked for. Rows and columns are MATLAB's."""
    h5py = need("h5py", path)
    shapes: dict[str, tuple[int, ...]] = {}
    inside: dict[str, str] = {}

    def add(name: str, item: Any, depth: int) -> None:
        if isinstance(item, h5py.Group):
            for key in item if depth < DEPTH else ():
                if not key.startswith("#") and isinstance(item.get(key, getlink=True), h5py.HardLink):
                    add(f"{name}.{key}" if name else str(key), item[key], depth + 1)
        elif item.external is None and not item.is_virtual and item.dtype.kind in "fiub" and item.size > 1 and item.ndim <= 2:
            shapes[name], inside[name] = _squeezed(item.shape[::-1]), item.name  # data in other files are not read

    with h5py.File(path, "r") as file:
        add("", file, 0)
    return Table(shapes, {name: partial(_dataset, path, name, inside[name], shape) for name, shape in shapes.items()})


def _squeezed(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(n for n in shape if n != 1)


def _dataset(path: Path, name: str, inside: str, shape: tuple[int, ...]) -> np.ndarray:
    need_size(path, name, 8.0 * float(np.prod(shape)))
    with need("h5py", path).File(path, "r") as file:
        return np.asarray(file[inside][()], float).T.reshape(shape)
