"""Elements of a MATLAB version 5 file, checked before SciPy reads them.

`scipy.io.loadmat` looks up the type of a numeric element in a table of C pointers without a test of its range: a damaged type
ends the process with a segmentation fault. The walk here reads tags alone and passes over the numbers.
Source: MathWorks, MAT-File Format (R2023b), chapter 1: an element is a tag (type, size in bytes), data, and zeros up to 8 bytes;
a matrix holds array flags, dimensions, a name, and what its class demands.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol, final

__all__ = ["check_elements"]

HEADER = 128  # bytes of text, version and order of bytes
MATRIX, COMPRESSED = 14, 15
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})  # int8 to uint32, single, double, int64, uint64
TEXT = NUMBERS | {16, 17, 18}  # and UTF-8, UTF-16, UTF-32
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
COMPLEX = 0x800  # flag of an array with an imaginary part
DEPTH = 100  # matrices inside matrices
LONGEST_NAMES = 2**20  # bytes of the names of a struct's fields
MOST_EMPTY = 2**16  # structs without a field: no data bound their number, and SciPy makes each
BLOCK = 2**20


class _Source(Protocol):
    """Bytes one after the other."""

    def read(self, count: int, /) -> bytes:
        """At most so many bytes, fewer at the end."""


@final
class _Inflated:
    """What a deflate stream gives."""

    def __init__(self, data: bytes) -> None:
        self._stream, self._data, self._ready = zlib.decompressobj(), data, b""

    def read(self, count: int, /) -> bytes:
        """At most so many bytes, fewer at the end."""
        while len(self._ready) < count and self._data and not self._stream.eof:
            self._ready += self._stream.decompress(self._data, BLOCK)
            self._data = self._stream.unconsumed_tail
        out, self._ready = self._ready[:count], self._ready[count:]
        return out


def check_elements(path: Path) -> None:
    """Raise ValueError where an element has a type that its place does not allow, or ends beyond the data.

    A file whose first four bytes have a zero among them is of version 4 and has no elements.
    """
    with path.open("rb") as file:
        header = file.read(HEADER)
        if 0 in header[:4] or len(header) < HEADER:
            return
        order = "<" if header[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, count = struct.unpack(f"{order}II", tag)
            end = file.tell() + count
            if kind == COMPRESSED:
                source = _Inflated(file.read(count))
                inner, _ = struct.unpack(f"{order}II", _exactly(source, 8))
                _need(inner, frozenset({MATRIX}))
                _matrix(source, order, 0)
            else:
                _need(kind, frozenset({MATRIX}))
                _matrix(file, order, 0)
            file.seek(end)


def _exactly(source: _Source, count: int) -> bytes:
    data = source.read(count)
    if len(data) < count:
        raise ValueError("an element ends beyond the data")
    return data


def _need(kind: int, allowed: frozenset[int]) -> None:
    if kind not in allowed:
        raise ValueError(f"an element has the type {kind}")


def _element(source: _Source, order: str, allowed: frozenset[int], longest: int = 0) -> bytes:
    """Pass over one element; its data where they have at most ``longest`` bytes, else none."""
    tag = _exactly(source, 8)
    first, count = struct.unpack(f"{order}II", tag)
    if first >> 16:  # a small element: size and type share four bytes, the data are in the other four
        kind, count = first & 0xFFFF, first >> 16
        if count > 4:
            raise ValueError("a small element is longer than four bytes")
        _need(kind, allowed)
        return tag[4 : 4 + count]
    _need(first, allowed)
    data = b""
    for size in _blocks(count):
        part = _exactly(source, size)
        data = part if count <= min(longest, BLOCK) else b""
    source.read(-count % 8)
    return data


def _blocks(count: int) -> Iterator[int]:
    """Sizes of the parts in which so many bytes are read."""
    while count > 0:
        yield min(count, BLOCK)
        count -= BLOCK


def _matrix(source: _Source, order: str, depth: int) -> None:
    """Pass over the body of a matrix: its header, and what its class demands."""
    if depth > DEPTH:
        raise ValueError(f"matrices are nested more than {DEPTH} deep")
    flags = struct.unpack(f"{order}II", _exactly(source, 16)[8:])[0]
    kind, is_complex = flags & 0xFF, bool(flags & COMPLEX)
    if kind != OPAQUE:
        dimensions = _element(source, order, NUMBERS, 4 * 32)
        _element(source, order, TEXT)
    match kind:
        case 0:
            raise ValueError("a matrix has the class 0")
        case _ if kind in (CELL, STRUCT, OBJECT):
            _parts(source, order, kind, _product(dimensions, order), depth)
        case _ if kind == SPARSE:
            for _ in range(3 + is_complex):
                _element(source, order, NUMBERS)
        case _ if kind == FUNCTION:
            _inner(source, order, depth)
        case _ if kind == OPAQUE:
            for _ in range(3):  # name, kind of object, class
                _element(source, order, TEXT)
            _inner(source, order, depth)
        case _ if kind == CHAR:
            _element(source, order, TEXT)
        case _:
            for _ in range(1 + is_complex):
                _element(source, order, NUMBERS)


def _product(dimensions: bytes, order: str) -> int:
    """Number of elements of an array by its dimensions."""
    return math.prod(max(0, d) for d in struct.unpack(f"{order}{len(dimensions) // 4}i", dimensions[: len(dimensions) // 4 * 4]))


def _parts(source: _Source, order: str, kind: int, count: int, depth: int) -> None:
    """Pass over the matrices inside a cell array or a struct."""
    fields = 1
    if kind != CELL:
        if kind == OBJECT:
            _element(source, order, TEXT)
        length = _element(source, order, NUMBERS, 8)
        names = _element(source, order, TEXT, LONGEST_NAMES)
        width = int.from_bytes(length[:4], "little" if order == "<" else "big", signed=True)
        if width <= 0 or len(names) % width:
            raise ValueError(f"names of a struct's fields of {width} bytes each do not fill {len(names)} bytes")
        fields = len(names) // width
        if not fields and count > MOST_EMPTY:
            raise ValueError(f"{count} structs without a field")
    for _ in range(count * fields):
        _inner(source, order, depth)


def _inner(source: _Source, order: str, depth: int) -> None:
    """Pass over a matrix with its tag; one of size zero is an empty array."""
    kind, count = struct.unpack(f"{order}II", _exactly(source, 8))
    _need(kind, frozenset({MATRIX}))
    if count:
        _matrix(source, order, depth + 1)
