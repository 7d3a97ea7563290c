"""Torque of a joint: elastic with play, hardening and internal slip, averaged over a step of straight deflection."""

from __future__ import annotations

from numba import njit

from lab.benchmark.friction import bristle_step
from lab.benchmark.laws import GAP_ELASTO, GAP_IMPACT

__all__ = ["joint_torque", "play", "slip_step"]


@njit(cache=True, nogil=True, inline="always")
def play(start: float, end: float, half: float) -> tuple[float, float]:
    """Mean stretch beyond a play of +-half [rad] and fraction in contact, on the line from start to end."""
    e0 = start - min(max(start, -half), half)
    e1 = end - min(max(end, -half), half)
    if half <= 0.0 or (e0 > 0.0 and e1 > 0.0) or (e0 < 0.0 and e1 < 0.0):
        return 0.5 * (e0 + e1), 1.0
    if (e0 == 0.0 and e1 == 0.0) or end == start:
        return 0.0, 0.0
    return 0.5 * (e1 * e1 - e0 * e0) / (end - start), (e1 - e0) / (end - start)


@njit(cache=True, nogil=True, inline="always")
def joint_torque(
    phi: float, rate: float, rate_now: float, k: float, k3: float, d: float, gap: float, law: float, impact: float, h: float
) -> float:
    """Torque [Nm] of a joint at mid-step; deflection phi [rad], its rate [rad/s] there and at the step's start.

    T = k e + k3 e^3 + d phi', with e the stretch beyond the play, nothing inside it; `laws` lists the variants.
    """
    half = 0.5 * gap
    e, touch = play(phi - 0.5 * h * rate_now, phi + 0.5 * h * rate_now, half)
    spring = k * e + k3 * e * e * e
    if law == GAP_ELASTO or gap <= 0.0:
        return spring + touch * d * rate
    T = spring + touch * d * rate
    if law == GAP_IMPACT:
        T = spring * (1.0 + impact * (rate if e > 0.0 else -rate))
    return T if T * e > 0.0 else 0.0


@njit(cache=True, nogil=True, inline="always")
def slip_step(z: float, rate: float, k: float, limit: float, sharp: float, h: float) -> tuple[float, float]:
    """Mean and final torque [Nm] of an elasto-plastic element of stiffness k that yields at ``limit``.

    Gradual (Bouc-Wen, n = 1, gamma = 0): z' = k phi' - k |phi'| z / limit.
    Sharp (Maxwell slip): z' = k phi', |z| <= limit.
    """
    if sharp > 0.0:
        end = min(max(z + h * k * rate, -limit), limit)
        return min(max(z + 0.5 * h * k * rate, -limit), limit), end
    mid, end = bristle_step(z / k, rate, limit, k, h)
    return k * mid, k * end
