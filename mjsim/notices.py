"""Who is told that code is about to be compiled, which takes long enough for a user to wonder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["compiling", "quiet", "tell_compiling"]

_LISTENERS: list[Callable[[bool], None]] = []


def tell_compiling(listener: Callable[[bool], None]) -> None:
    """Call ``listener(kept)`` once, before the first function is compiled that is not on disk; ``kept``: whether it will be."""
    _LISTENERS.append(listener)


def compiling(*, kept: bool = True) -> None:
    """A function is not on disk and is compiled next; ``kept``: there is a folder for its code."""
    told, _LISTENERS[:] = list(_LISTENERS), []
    for listener in told:
        listener(kept)


@contextmanager
def quiet() -> Iterator[None]:
    """Tell nobody meanwhile, where somebody else follows what is compiled."""
    kept, _LISTENERS[:] = list(_LISTENERS), []
    try:
        yield
    finally:
        _LISTENERS[:] = kept
