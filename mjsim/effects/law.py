"""Laws as compiled functions with one signature, so that one compiled kernel runs any set of effects.

A law is ``f(z, p, out)``: it reads the local quantities ``z`` (indices below) and its parameters ``p``, and writes ``out``. It
compiles on first use (numba cfunc, cached on disk) and is called by address from the ODE kernel and from MuJoCo's passive
callback. The Python function stays callable on lists for tests.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["ANGLE", "DIRECTION", "FADED", "INPUT", "LOAD", "N_LOCAL", "POSITION", "RATE", "STATE", "TIME", "Law", "law"]

# The local quantities that a law may read: z[...]
TIME = 0  # s since the start of the recording
POSITION = 1  # body: angle; coupling: elastic deflection (beyond a gap) [rad | m]
RATE = 2  # body: velocity; coupling: deflection rate [rad/s | m/s]
DIRECTION = 3  # friction ports: -1 or +1, the sign of slip
LOAD = 4  # torque of the adjacent coupling on the body's own side; of the drive on a chain of one body [N m | N]
ANGLE = 5  # angle of the body (or ahead of the coupling), locked to the measured motor angle when there is one [rad | m]
INPUT = 6  # effective actuator torque [N m | N]
STATE = 7  # the port's internal state
N_LOCAL = 8

FADED = 700.0  # exponent from which exp(-x) counts for nothing; beyond 708 it underflows, which takes it five times as long


class Law:
    """A law function and, once needed, its machine address."""

    def __init__(self, function: Callable[[Any, Any, Any], None]) -> None:
        self.function = function
        self.name = f"{function.__module__}.{function.__name__}"
        self._compiled: Any = None

    def __call__(self, z: Any, p: Any, out: Any) -> None:
        """Evaluate in Python (tests, documentation)."""
        self.function(z, p, out)

    def __reduce__(self) -> Any:
        """Pickle by name: compiled code is made anew on the other side."""
        import operator

        module, _, name = self.name.rpartition(".")
        return (_resolve, (module, name)) if name else (operator.itemgetter, (0,))

    @property
    def address(self) -> int:
        """Machine address of the compiled law (C signature ``void(double*, double*, double*)``)."""
        if self._compiled is None:
            from numba import types

            from mjsim.compiled import callback

            pointer = types.CPointer(types.float64)
            self._compiled = callback(self.function, types.void, pointer, pointer, pointer)
        return int(self._compiled.address)


def _resolve(module: str, name: str) -> Any:
    import importlib

    return getattr(importlib.import_module(module), name)


def law(function: Callable[[Any, Any, Any], None]) -> Law:
    """Declare a law; see the module's text for its signature."""
    return Law(function)
