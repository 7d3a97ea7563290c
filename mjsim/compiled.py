"""Functions compiled by numba and kept on disk, loaded without what only compiling needs.

numba makes itself ready to compile (tables of types, the code behind every function of NumPy, scipy.linalg) before it looks
whether the code is on disk: three quarters of the time until the kernel is there. Code that is found needs none of it but the
runtime that counts references; what is not found is compiled as ever, after the same preparations.

Of several processes that need the same code one compiles it; the others wait and load it. Each holds a lock on a file beside the
code while it compiles, which the system frees where the process ends, however it ends. Where files cannot be locked (no `fcntl`,
some network file systems) each process compiles for itself.

Where no folder can be written (neither NUMBA_CACHE_DIR, nor the one beside the source, nor that of the user) a function is
compiled for this process alone.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # a system that is not POSIX
    fcntl = None  # type: ignore[assignment]

from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache, NullCache
from numba.core.ccallback import CFunc
from numba.core.runtime import rtsys

from mjsim.notices import compiling

__all__ = ["callback", "compiled", "kept_at"]


LONGEST = 180.0  # seconds to wait for another process that compiles, which takes less on one busy core; it may be suspended
PAUSE = 0.05  # seconds between two looks whether it has ended


class _Lock:
    """An exclusive lock on a file, which is removed once the lock is freed."""

    def __init__(self, path: Path) -> None:
        """Wait for the lock, `LONGEST` seconds at most; without a lock where there is none to be had."""
        self.path, self.descriptor = path, -1
        if fcntl is None:
            return
        end = time.monotonic() + LONGEST
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            self.descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            while True:
                try:
                    fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return
                except BlockingIOError:
                    if time.monotonic() > end:
                        break
                    time.sleep(PAUSE)
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1

    def free(self) -> None:
        """Free the lock; who waits for it finds the code on disk, so that the file need not stay."""
        if self.descriptor >= 0:
            with contextlib.suppress(OSError):
                self.path.unlink()
            os.close(self.descriptor)
            self.descriptor = -1


@contextlib.contextmanager
def _alone(folder: str) -> Iterator[None]:
    """No other process changes the indices in ``folder`` meanwhile, where a folder can be locked."""
    descriptor = -1
    try:
        with contextlib.suppress(OSError):
            if fcntl is not None:
                descriptor = os.open(folder, os.O_RDONLY)
                fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        if descriptor >= 0:
            os.close(descriptor)


class _Kept(FunctionCache):
    """numba's cache on disk; it is asked before anything is prepared for compiling.

    numba asks and keeps while it holds its lock for compiling, so that one thread at a time is here.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        base: Any = super()
        base.__init__(function)
        self._locks: list[_Lock] = []  # of the signatures that are being compiled, each for the one before

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code for a signature; None where there is none, which this process compiles next (`save_overload`, `free`)."""
        rtsys.initialize(target_context)
        found = self._found(sig, target_context)
        if found is None:
            compiling()
            base: Any = super()
            key = repr(base._index_key(sig, target_context.codegen()))
            name = f"{self._impl.filename_base}.{hashlib.sha256(key.encode()).hexdigest()[:16]}.lock"
            self._locks.append(_Lock(Path(self.cache_path) / name))
            found = self._found(sig, target_context)  # another process compiled it meanwhile
            if found is not None:
                self.free()
        return found

    def _found(self, sig: Any, target_context: Any) -> Any:
        base: Any = super()
        with self._guard_against_spurious_io_errors():
            return base._load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code, where the disk takes it, and let other processes have it."""
        base: Any = super()
        try:
            with contextlib.suppress(OSError), _alone(self.cache_path):
                base.save_overload(sig, data)
        finally:
            self.free()

    def free(self) -> None:
        """Free the lock of the last signature that was not found."""
        if self._locks:
            self._locks.pop().free()


class _Unkept(NullCache):
    """In place of a cache where no folder can be written."""

    def load_overload(self, sig: Any, target_context: Any) -> None:
        """Nothing is there."""
        compiling(kept=False)

    def free(self) -> None:
        """Nothing is locked."""


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
        """The last one, compiled or failed, starts it again where it ran before; one that failed is not kept."""
        function = ended.data["dispatcher"]
        if isinstance(function._cache, _Kept) and tuple(ended.data["args"]) not in function.overloads:
            function._cache.free()
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
    made._cache = kept = _cache(function)
    try:
        made.compile()
    finally:
        kept.free()
    return made
