"""A table of named columns that are read when they are asked for, and the limits of what is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from mjsim.errors import InputError

__all__ = ["MOST_BYTES", "Table", "first_line", "need_size"]

MOST_BYTES = 2**32
"""Largest array, decompressed member or message that is read [bytes]: 24 h of three channels at 2 kHz are 4.1e9 bytes."""


def first_line(error: BaseException) -> str:
    """The first line of an error's message, or its type where it has none."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


def need_size(path: object, name: str, size: float) -> None:
    """Raise InputError where a column of so many bytes is larger than `MOST_BYTES`."""
    if size > MOST_BYTES:
        raise InputError(
            path, f"{name!r} holds {size:.3g} bytes", f"at most {MOST_BYTES:.3g} bytes", "cut the recording into parts"
        )


class Table(Mapping[str, np.ndarray]):
    """Columns (N,) or matrices (rows, N) of float64 by name, in the order of the file.

    shapes: the shape of each, known before it is read. loaders: what reads it. An array is read once. notes: what was guessed or
    changed in reading, in sentences. by_joint: whether ``_rad`` and ``_Nm`` in names mean metres and newtons on slides. hint:
    what to write where the columns do not have the default names.
    """

    def __init__(
        self, shapes: Mapping[str, tuple[int, ...]], loaders: Mapping[str, Callable[[], np.ndarray]],
        notes: tuple[str, ...] = (), *, by_joint: bool = False, hint: str = "",
    ) -> None:  # fmt: skip
        self.shapes = dict(shapes)
        self.notes, self.by_joint, self.hint = notes, by_joint, hint
        self._loaders = dict(loaders)
        self._arrays: dict[str, np.ndarray] = {}

    @classmethod
    def of(
        cls, arrays: Mapping[str, np.ndarray], notes: tuple[str, ...] = (), *, by_joint: bool = False, hint: str = ""
    ) -> Table:
        """A table of arrays that are read already."""
        table = cls({name: a.shape for name, a in arrays.items()}, {}, notes, by_joint=by_joint, hint=hint)
        table._arrays = dict(arrays)
        return table

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._arrays:
            self._arrays[name] = self._loaders[name]()
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.shapes)

    def __len__(self) -> int:
        return len(self.shapes)

    def of_length(self, count: int) -> dict[str, np.ndarray]:
        """The columns (count,) that can be read; one that cannot be read matters only to who asks for it by name."""
        out = {}
        for name, shape in self.shapes.items():
            if shape != (count,):
                continue
            try:
                out[name] = self[name]
            except InputError:
                continue
        return out
