"""Ends of the travel at which a recorded motion is turned back as at a stop: where a fit of a stop starts.

The strongest accelerations of a joint that strikes its stops lie at the ends of its travel and point inwards, visit after visit.
"""

from __future__ import annotations

import math

import numpy as np

__all__ = ["stops_of"]

STRONGEST = 0.02  # share of the samples, those of the largest acceleration
NEAR_PEAK = 0.25  # of the largest acceleration: impacts are short, and may be fewer samples than that
AT_END = 0.1  # of the travel
MOST = 0.7  # share of the strongest accelerations that are such
VISITS = 3  # of both ends together, each with such accelerations, from which on they are stops


def stops_of(q: np.ndarray, v: np.ndarray, dt: float) -> tuple[tuple[int, float, float], ...]:
    """(side, angle [rad | m], time constant [s]) of each end that acts as a stop; q, v (N,): angle and velocity.

    Side: -1 lower, +1 upper. The angle is that at which the strong accelerations begin. The time constant is that of a critically
    damped stop, which is entered by v T / e.
    """
    span = float(np.ptp(q))
    if span <= 0 or len(q) < VISITS / STRONGEST:
        return ()
    change = np.gradient(v, dt)
    size = np.abs(change)
    level = float(np.quantile(size, 1.0 - STRONGEST))
    found: dict[int, tuple[int, float, float]] = {}
    for strong in (size >= level, size >= max(level, NEAR_PEAK * float(np.max(size)))):
        found |= {end[0]: end for end in _turned_back(q, v, change, strong, dt)}
    return tuple(found[side] for side in sorted(found))


def _turned_back(
    q: np.ndarray, v: np.ndarray, change: np.ndarray, strong: np.ndarray, dt: float
) -> tuple[tuple[int, float, float], ...]:
    """The ends at which the ``strong`` accelerations (N,) bool act; none where too many of them act elsewhere."""
    span = float(np.ptp(q))
    found, hits, times = [], 0, 0
    for side in (-1, 1):
        end = float(np.max(side * q))
        near = side * q > end - AT_END * span
        at = np.flatnonzero(strong & near & (side * change < 0))
        visits = np.cumsum(np.diff(near.astype(int), prepend=0) > 0)
        if not len(at):
            continue
        hits, times = hits + len(at), times + len(np.unique(visits[at]))
        angle = float(np.quantile(side * q[at], 0.1))
        speed = float(np.quantile(np.abs(v[at]), 0.9))
        found.append((side, side * angle, max(math.e * (end - angle) / max(speed, 1e-300), 0.5 * dt)))
    return tuple(found) if times >= VISITS and hits >= MOST * int(np.sum(strong)) else ()
