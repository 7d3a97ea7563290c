"""The yardstick of what is predictable of a residual of unknown noise: a ridge regression, judged on held-out samples."""

from __future__ import annotations

import math

import numpy as np

from diagnose.evidence.held_out import compare
from diagnose.fit.fitted import HeldOut
from diagnose.robot.linear import solved

__all__ = ["predictable", "ridge"]


def ridge(columns: np.ndarray, residual: np.ndarray, weight: float = 1e-2) -> np.ndarray:
    """Coefficients (k,) of columns (N, k) for a residual (N,); ``weight``: of the penalty, times a column's sum of squares.

    minimise |residual - D c|^2 + weight sum_k (|d_k| c_k)^2
    """
    size = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    unit = columns / size
    return np.asarray(solved(unit.T @ unit + weight * np.eye(len(size)), unit.T @ residual) / size)


def predictable(before: HeldOut, left: np.ndarray) -> tuple[float, float]:
    """(share of the held-out squared error that a prediction takes, its one-sided p-value).

    left (N,): what it leaves, weighted and in the order of ``before.errors``. 0 where it diverges.
    """
    edges = np.cumsum(before.n)[:-1]
    after = HeldOut(left, np.array([float(p @ p) for p in np.split(left, edges)]), before.n, 0.0, 0.0)
    test = compare(before, after)
    return (test.relative_gain if math.isfinite(test.relative_gain) else 0.0), test.p_value
