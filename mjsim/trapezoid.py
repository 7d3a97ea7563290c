"""The target of a servo that goes to its command with a bounded acceleration, and brakes in time to stop there.

r'' = +-A such that r is at the command c, and at rest, in the shortest time with |r''| <= A and |r'| <= V. In steps h, with
e = c - r:

    w = sign(e) min(sqrt((A h / 2)^2 + 2 A |e|) - A h / 2, |e| / h, V)        speed from which it still stops at the command
    r' += clip(w - r', -A h, A h),    r += h r'

It begins at the first command, at rest. A moving command is that at the end of each step: without
bounds r is the command.
Source: L. Biagiotti, C. Melchiorri, Trajectory Planning for Automatic Machines and Robots (2008), ch. 4; R. Zanasi, C. Guarino Lo
Bianco, A. Tonielli, Nonlinear filters for the generation of smooth trajectories, Automatica 36 (2000) 439.
"""

from __future__ import annotations

import math

import numpy as np

from mjsim.compiled import compiled

__all__ = ["PERIOD", "finely", "parts_of", "profiled"]

PERIOD = 1e-3  # [s]: longest step, the period of most drives


def parts_of(dt: float) -> int:
    """Steps in a sample of dt [s]."""
    return max(1, math.ceil(dt / PERIOD - 1e-6))


def finely(start: np.ndarray, slope: np.ndarray, dt: float, limit: float, acceleration: float) -> np.ndarray:
    """Target (N parts + 1,) at the ends of the steps, ``parts_of(dt)`` a sample; it goes in straight lines between them.

    start, slope (N,): command at the start of each sample of dt [s] and its slope over it (`mjsim.hold.between`); limit,
    acceleration: largest speed, infinity for none, and its largest rate.
    """
    out = np.empty(len(start) * parts_of(dt) + 1)
    start, slope = (np.ascontiguousarray(x, float) for x in (start, slope))
    _follow(start, slope, dt / parts_of(dt), parts_of(dt), limit, acceleration, out)
    return out


def profiled(start: np.ndarray, slope: np.ndarray, dt: float, limit: float, acceleration: float) -> tuple[np.ndarray, np.ndarray]:
    """The target of `finely` as its own start and slope of each sample, each (N,).

    The straight line of a sample has the mean and the first moment of the target there, so that what it drives is met to third
    order in dt.
    """
    fine, parts = finely(start, slope, dt, limit, acceleration), parts_of(dt)
    ends = fine[:-1].reshape(-1, parts)
    rise = np.diff(fine).reshape(-1, parts)
    mean = np.mean(ends + 0.5 * rise, axis=1)
    # first moment about the middle of the sample, over its length squared: of each step that of its mean and of its own slope
    at = (np.arange(parts) + 0.5) / parts - 0.5
    moment = np.mean((ends + 0.5 * rise) * at + rise / (12.0 * parts), axis=1)
    grow = 12.0 * moment / dt
    return mean - 0.5 * dt * grow, grow


@compiled(error_model="numpy")
def _follow(
    start: np.ndarray, slope: np.ndarray, h: float, parts: int, limit: float, acceleration: float, out: np.ndarray
) -> None:
    """Write the target at the ends of all steps of h [s] to ``out`` (N parts + 1,)."""
    r = start[0] if len(start) else 0.0
    v, most = 0.0, acceleration * h
    out[0] = r
    for k in range(len(start)):
        for i in range(parts):
            e = start[k] + slope[k] * (i + 1) * h - r
            way = abs(e)
            # sqrt(a^2 + b) - a as b / (sqrt(a^2 + b) + a), which keeps its digits under a large acceleration
            both = 2.0 * acceleration * way
            w = min(both / (math.sqrt(0.25 * most * most + both) + 0.5 * most), way / h, limit)
            if e < 0.0:
                w = -w
            v += min(max(w - v, -most), most)
            r += h * v
            out[k * parts + i + 1] = r
