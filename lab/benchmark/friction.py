"""Dry friction of one body as a differential inclusion, solved exactly while the other torques are constant.

    J v' = F - L+ for v > 0,   J v' = F + L- for v < 0,   v = 0 stays while -B- <= F <= B+

A body that comes to rest inside the step stays there or leaves again at once, with the time left of the step; a body
that breaks loose inside the step moves for the time since it did. So a reversal costs no first-order error.
"""

from __future__ import annotations

import math

from numba import njit

__all__ = ["bristle_step", "dry_step"]


@njit(cache=True, nogil=True, inline="always")
def dry_step(
    v: float, drive: float, drive_before: float, L_up: float, L_down: float, L0_up: float, L0_down: float, B_up: float,
    B_down: float, J: float, h: float, jump: bool
) -> float:  # fmt: skip
    """Velocity [rad/s] after ``h`` seconds of the inclusion above.

    ``L_*`` are the levels at the present speed, ``L0_*`` those at rest and ``B_*`` the breakaway levels [Nm];
    ``drive_before`` is the torque one step ago, by which the moment of release is found; ``jump`` tells that the input
    jumped at the step's start.
    """
    if v == 0.0:
        if drive > B_up:
            level, bound = L0_up, B_up
        elif drive < -B_down:
            level, bound = -L0_down, -B_down
        else:
            return 0.0
        time = h
        if not jump and bound != 0.0 and (drive_before - bound) * (drive - bound) <= 0.0 and drive != drive_before:
            time = 0.5 * h + h * (drive - bound) / (drive - drive_before)
        return (drive - level) / J * time
    level = L_up if v > 0.0 else -L_down
    a = (drive - level) / J
    end = v + h * a
    if end * v > 0.0:
        return end
    left = h + v / a  # a opposes v here, so this is the time after the crossing
    if drive > B_up:
        return left * (drive - L0_up) / J
    if drive < -B_down:
        return left * (drive + L0_down) / J
    return 0.0


@njit(cache=True, nogil=True, inline="always")
def bristle_step(z: float, v: float, level: float, stiffness: float, h: float) -> tuple[float, float]:
    """Mean and final bristle deflection [rad] over a step at constant v of  z' = v - stiffness |v| z / level."""
    rate = stiffness * abs(v) / level
    if rate * h < 1e-9:
        return z + 0.5 * h * v, z + h * v
    steady = level / stiffness if v > 0.0 else -level / stiffness
    x = rate * h
    decay = -math.expm1(-x)
    return steady + (z - steady) * decay / x, z + (steady - z) * decay
