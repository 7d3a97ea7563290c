"""Functions compiled by numba and kept on disk, loaded without what only compiling needs.

numba makes itself ready to compile (tables of types, the code behind every function of NumPy, scipy.linalg) before it looks
whether the code is on disk: three quarters of the time until the kernel is there. Code that is found needs none of it but the
runtime that counts references; what is not found is compiled as ever, after the same preparations.

Where no folder can be written (neither NUMBA_CACHE_DIR, nor the one beside the source, nor that of the user) a function is
compiled for this process alone.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache, NullCache
from numba.core.ccallback import CFunc
from numba.core.runtime import rtsys

from mjsim.notices import compiling

__all__ = ["callback", "compiled", "kept_at"]


class _Kept(FunctionCache):
    """numba's cache on disk; it is asked before anything is prepared for compiling."""

    def __init__(self, function: Callable[..., Any]) -> None:
        base: Any = super()
        base.__init__(function)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code for a signature, None where there is none."""
        rtsys.initialize(target_context)
        base: Any = super()
        with self._guard_against_spurious_io_errors():
            found = base._load_overload(sig, target_context)
        if found is None:
            compiling()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code, where the disk takes it."""
        base: Any = super()
        with contextlib.suppress(OSError):
            base.save_overload(sig, data)


class _Unkept(NullCache):
    """In place of a cache where no folder can be written."""

    def load_overload(self, sig: Any, target_context: Any) -> None:
        """Nothing is there."""
        compiling(kept=False)


class _Uncollected(event.Listener):
    """Python's collector of cycles rests while numba compiles, which makes millions of objects that live until it ends.

    numba sends both events while it holds its lock for compiling, so that one thread at a time is here.
    """

    def __init__(self) -> None:
        self.depth, self.was = 0, False

    def on_start(self, started: Any) -> None:
        """The first of the functions that are being compiled, each for the one before, stops the collector."""
        if self.depth == 0:
            self.was = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, ended: Any) -> None:
        """The last one, compiled or failed, starts it again where it ran before."""
        self.depth -= 1
        if self.depth == 0 and self.was:
            gc.enable()


event.register("numba:compile", _Uncollected())


def _cache(function: Callable[..., Any]) -> _Kept | _Unkept:
    try:
        return _Kept(function)
    except RuntimeError:  # numba found no folder that it may write
        return _Unkept()


def kept_at(dispatcher: Any) -> str | None:
    """The folder that keeps the code of a function made by `compiled`; None where none can be written."""
    path: str | None = dispatcher._cache.cache_path
    return path


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Like `numba.njit`: a function that leaves the interpreter's lock, kept on disk."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(nogil=True, **options)(function)
        dispatcher._cache = _cache(function)
        return dispatcher

    return decorate


def callback(function: Callable[..., Any], answer: Any, *arguments: Any) -> Any:
    """Like `numba.cfunc`: a function that C can call, kept on disk; ``answer``, ``arguments``: their types."""
    made: Any = CFunc(function, (arguments, answer), {}, {})
    made._cache = _cache(function)
    made.compile()
    return made
