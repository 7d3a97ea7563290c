"""Functions compiled by numba and kept on disk, loaded without what only compiling needs.

numba makes itself ready to compile (tables of types, the code behind every function of NumPy, scipy.linalg) before it looks
whether the code is on disk: three quarters of the time until the kernel is there. Code that is found needs none of it but the
runtime that counts references; what is not found is compiled as ever, after the same preparations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc
from numba.core.runtime import rtsys

from mjsim.notices import compiling

__all__ = ["callback", "compiled"]


class _Kept(FunctionCache):
    """numba's cache on disk; it is asked before anything is prepared for compiling."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code for a signature, None where there is none."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            found = self._load_overload(sig, target_context)
        if found is None:
            compiling()
        return found


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Like `numba.njit`: a function that leaves the interpreter's lock, kept on disk."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(nogil=True, **options)(function)
        dispatcher._cache = _Kept(function)
        return dispatcher

    return decorate


def callback(function: Callable[..., Any], answer: Any, *arguments: Any) -> Any:
    """Like `numba.cfunc`: a function that C can call, kept on disk; ``answer``, ``arguments``: their types."""
    made: Any = CFunc(function, (arguments, answer), {}, {})
    made._cache = _Kept(function)
    made.compile()
    return made
