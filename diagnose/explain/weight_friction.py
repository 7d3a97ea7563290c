"""Friction over the angle that may be friction by the load of a weight.

On an axis whose load is a weight the torque T(q) that is transmitted is a function of the angle, and so is a friction c |T(q)|.
One load does not tell the two apart: another one moves the latter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnose.thresholds import SMALL
from mjsim.chain import Chain
from mjsim.effects import Effect
from mjsim.effects.law import ANGLE, DIRECTION, N_LOCAL, POSITION, RATE
from mjsim.effects.ports import BodyTorque, Friction
from mjsim.effects.registry import registered

__all__ = ["follows_weight", "load_effects"]


def load_effects(effect: Effect) -> tuple[str, ...]:
    """Identifiers of the effects of the same family that grow with the transmitted torque."""
    own = type(effect)
    if own.by_load:
        return ()
    return tuple(dict.fromkeys(cls.name() for cls in registered().values() if cls.by_load and cls.family == own.family))


def follows_weight(effect: Effect, others: Sequence[Effect], chain: Chain, angle: np.ndarray, speed: float) -> float:
    """Correlation, over measured angles (N,) [rad], of a friction level with the size of the torques that hang on the angle.

    0 where the level does not vary with the angle, or no torque does; ``speed`` [rad/s] of the motion.
    """
    level = _over_angle([p for p in effect.ports(chain) if isinstance(p, Friction)], angle, speed)
    weight = _over_angle([p for e in others for p in e.ports(chain) if isinstance(p, BodyTorque) and not p.state], angle, speed)
    if np.std(level) <= SMALL * abs(float(np.mean(level))) or np.std(weight) <= 1e-9 * (np.max(np.abs(weight)) + 1e-300):
        return 0.0
    return float(np.corrcoef(level, np.abs(weight))[0, 1])


def _over_angle(ports: Sequence[Friction | BodyTorque], angle: np.ndarray, speed: float) -> np.ndarray:
    """Sum of the laws of some ports over angles (N,), at one speed."""
    out = np.zeros(len(angle))
    for port in ports:
        for k, q in enumerate(angle):
            z, y = [0.0] * N_LOCAL, [0.0, 0.0]
            z[ANGLE] = z[POSITION] = float(q)
            z[RATE], z[DIRECTION] = speed, 1.0
            port.law(z, port.p, y)
            out[k] += y[0]
    return out
