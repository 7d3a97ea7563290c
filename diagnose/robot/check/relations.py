"""Relations between two channels of a joint: slope, delay, and the part of the variance that they explain."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

__all__ = ["Relation", "correlations", "relate"]

WINDOW = 0.5  # [s]: largest delay that is tried; a servo's own lag is below it
CONSTANT = 1e-9  # of its size: what rounding makes of a signal that does not vary
SHARE = 0.1  # of the duration: the largest delay of a short log


@dataclass(frozen=True)
class Relation:
    """y(t) = slope x(t - delay) + constant (+ other columns): slope, delay [s] and explained part of the variance of y.

    opposite: part that the other sign of the slope explains, at its own best delay. A sine that is late by half its period has
    the other sign.
    """

    slope: float
    delay: float
    explained: float
    opposite: float = 0.0


def relate(x: np.ndarray, y: np.ndarray, dt: float, beside: np.ndarray | None = None, *, delays: bool = True) -> Relation | None:
    """The relation of two signals (N,) at the delay that leaves least, refined by a parabola; None where one does not vary.

    ``beside`` (N, k): further columns, not delayed. ``delays``: whether a delay is free; else it is 0.
    """
    from scipy.signal import correlate

    n = len(x)
    most = round(min(WINDOW / dt, SHARE * n)) if delays else 0
    inner = slice(most, n - most)
    target = y[inner] - np.mean(y[inner])
    total = float(target @ target)
    if np.ptp(x) <= CONSTANT * float(np.max(np.abs(x))) or total <= 1e-24 * n:
        return None
    other = np.ones((n, 1)) if beside is None else np.column_stack([np.ones(n), beside])
    Q = np.linalg.qr(other[inner])[0]
    left = target - Q @ (Q.T @ target)

    moved = x - np.mean(x)
    # of x at each delay, without what the other columns explain: its square, and its product with what y leaves
    total_of = np.concatenate([[0.0], np.cumsum(moved**2)])
    size = total_of[n - 2 * most :] - total_of[: 2 * most + 1]
    for column in Q.T:
        size = size - correlate(moved, column, "valid") ** 2
    product = correlate(moved, left, "valid")
    slopes = np.where(size > 1e-12 * np.max(np.abs(size)), product / np.where(size > 0.0, size, 1.0), 0.0)[::-1]
    errors = float(left @ left) - slopes * product[::-1]
    best = int(np.argmin(errors))
    other_sign = errors[slopes * slopes[best] < 0.0]
    offset = 0.0
    if 0 < best < len(errors) - 1:
        a, b, c = errors[best - 1 : best + 2]
        curve = a - 2 * b + c
        offset = 0.5 * (a - c) / curve if curve > 0 else 0.0
    opposite = 1.0 - float(np.min(other_sign)) / total if len(other_sign) else 0.0
    return Relation(float(slopes[best]), float((best - most + offset) * dt), float(1.0 - errors[best] / total), opposite)


def correlations(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Correlation (J, K) of every column of x (N, J) with every one of y (N, K); 0 for what does not vary or is not there."""

    def unit(a: np.ndarray) -> np.ndarray:
        a = np.nan_to_num(a) - np.nan_to_num(a).mean(axis=0)
        size = np.linalg.norm(a, axis=0)
        return np.where(size > 1e-12 * math.sqrt(len(a)), a / np.maximum(size, 1e-300), 0.0)

    return np.asarray(unit(x).T @ unit(y))
