"""What a law of an effect is like, by its values at some points: slopes, levels, whether its state is a bristle's."""

from __future__ import annotations

import math
from functools import lru_cache

from mjsim.effects.law import DIRECTION, N_LOCAL, RATE, Law
from mjsim.effects.ports import Friction

__all__ = ["constant", "follows_rate", "levels", "slope", "yields"]


def slope(law: Law, p: tuple[float, ...], local: int, step: float, about: float = 0.0) -> float:
    """How fast a law's torque falls as one local quantity grows, all others at zero: the spring, or damper, that it is there."""
    torque = []
    for x in (-step, step):
        z, out = [0.0] * N_LOCAL, [0.0] * 3
        z[local] = about + x
        law(z, p, out)
        torque.append(out[0])
    return (torque[0] - torque[1]) / (2.0 * step)


def yields(law: Law, p: tuple[float, ...]) -> float:
    """How far a bristle goes along before it slides, at high speed; infinite where it never does."""
    z, out = [0.0] * N_LOCAL, [0.0] * 3
    z[RATE] = 1e3
    law(z, p, out)
    return z[RATE] / out[2] if out[2] > 0.0 else math.inf


def follows_rate(law: Law, p: tuple[float, ...]) -> bool:
    """Whether the state of a law grows with the rate of its place, as a bristle's deflection does."""
    z, rest, moving = [0.0] * N_LOCAL, [0.0] * 3, [0.0] * 3
    law(z, p, rest)
    z[RATE] = 1.0
    law(z, p, moving)
    return moving[1] != rest[1]


def levels(port: Friction) -> tuple[float, float, float, float] | None:
    """Sliding level forward, backward, breakaway level forward, backward; None where they are not constant."""
    forward, backward = constant(port.law, port.p, 1.0), constant(port.law, port.p, -1.0)
    return None if forward is None or backward is None else (forward[0], backward[0], forward[1], backward[1])


@lru_cache(256)  # fits change one number of many at a time
def constant(law: Law, p: tuple[float, ...], direction: float) -> tuple[float, float] | None:
    """What the law writes when it is the same for all local quantities but the direction of slip, else None."""
    seen = None
    for values in _PROBES:
        z, out = [*values], [0.0, 0.0, 0.0]
        z[DIRECTION] = direction
        law(z, p, out)
        if seen is not None and seen != (out[0], out[1]):
            return None
        seen = (out[0], out[1])
    return seen


# Times, angles, rates, loads and states at which a law is tried: five decades of each, no two in step
_PROBES = tuple(tuple(10.0 ** (k - 3 + 0.3 * i) * (-1) ** (k * i) for i in range(N_LOCAL)) for k in range(6))
