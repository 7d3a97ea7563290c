"""Torque of a joint: elastic with play, hardening and internal slip, averaged over a step on which the deflection is a line."""

from __future__ import annotations

import math

from numba import njit

from simgap.benchmark.laws import GAP_ELASTO, GAP_IMPACT

__all__ = ["joint_torque", "play", "slip_step"]


@njit(cache=True, nogil=True, inline="always")
def play(start, end, half):
    """Mean stretch beyond a play of +-half [rad] and the fraction of the step in contact, on the line from start to end."""
    e0 = start - min(max(start, -half), half)
    e1 = end - min(max(end, -half), half)
    if half <= 0.0 or (e0 > 0.0 and e1 > 0.0) or (e0 < 0.0 and e1 < 0.0):
        return 0.5 * (e0 + e1), 1.0
    if (e0 == 0.0 and e1 == 0.0) or end == start:
        return 0.0, 0.0
    return 0.5 * (e1 * e1 - e0 * e0) / (end - start), (e1 - e0) / (end - start)


@njit(cache=True, nogil=True, inline="always")
def joint_torque(phi, rate, rate_now, k, k3, d, gap, law, impact, h):
    """Torque [Nm] of a joint at the mid-step deflection phi [rad]; rate [rad/s] at mid-step, rate_now at the step's start.

    Elastic  T = k e + k3 e^3 + d phi', with e the stretch beyond the play, nothing inside it; see `laws` for the variants.
    """
    half = 0.5 * gap
    e, touch = play(phi - 0.5 * h * rate_now, phi + 0.5 * h * rate_now, half)
    spring = k * e + k3 * e * e * e
    if law == GAP_ELASTO or gap <= 0.0:
        return spring + touch * d * rate
    if law == GAP_IMPACT:
        T = spring * (1.0 + impact * (rate if e > 0.0 else -rate))
    else:
        T = spring + touch * d * rate
    return T if T * e > 0.0 else 0.0


@njit(cache=True, nogil=True, inline="always")
def slip_step(z, rate, k, limit, smooth, h):
    """Mid and final torque [Nm] of a spring k in series with a slider of the given limit (Maxwell slip; Bouc-Wen if smooth).

    Maxwell slip: |z| <= limit, z' = k phi' inside.  Bouc-Wen (exponent 1, beta = gamma): z' = k phi' (1 - (1 + sign(z phi')) z^2/2).
    """
    if k <= 0.0:
        return 0.0, 0.0
    if smooth > 0.0:
        x = z / limit
        mid = z + 0.5 * h * k * rate * (1.0 - (0.5 * (1.0 + math.copysign(1.0, z * rate))) * x * x)
        x = mid / limit
        return mid, z + h * k * rate * (1.0 - (0.5 * (1.0 + math.copysign(1.0, mid * rate))) * x * x)
    end = min(max(z + h * k * rate, -limit), limit)
    return min(max(z + 0.5 * h * k * rate, -limit), limit), end
