"""The penalised regression behind a torque map: lambda by cross-validation over stretches of the estimation data.

    minimise |r + J a + D (c' - c)|^2 + lambda |S c'|^2

over the model's own numbers a and the map's coefficients c'.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from diagnose.fit.least_squares import orthonormal
from diagnose.thresholds import FOLDS, ROUNDING, SAME
from mjsim.torque_map import TorqueMap

__all__ = ["Regression", "Solution", "roughness", "solve"]


@dataclass(frozen=True, eq=False)
class Regression:
    """The regression at a map: residual r (N,) at coefficients c (k,), own sensitivities J (N, p), responses D (N, k) of the
    coefficients, roughness S (m, k), fold of each row (-1: in all of them, never judged)."""

    r: np.ndarray
    c: np.ndarray
    J: np.ndarray
    D: np.ndarray
    S: np.ndarray
    fold: np.ndarray


@dataclass(frozen=True, eq=False)
class Solution:
    """lambda, cross-validated cost over that without a map, directions V (k, l) of the coefficients, coefficients c (k,)."""

    penalty: float
    cost: float
    V: np.ndarray
    c: np.ndarray


def roughness(shape: TorqueMap) -> np.ndarray:
    """Second differences of the coefficients along each variable (m, k)."""
    counts = [a.count for a in shape.axes]
    differences = [np.diff(np.eye(n), 2, axis=0) for n in counts]
    if len(counts) == 1:
        return differences[0]
    return np.vstack([np.kron(differences[0], np.eye(counts[1])), np.kron(np.eye(counts[0]), differences[1])])


def solve(p: Regression, without: float) -> Solution:
    """Penalty by cross-validation, and the coefficients on all data; ``without``: cost without a map."""
    q = orthonormal(p.J)
    # directions of the map that the model's own numbers can mimic are left to them
    gram = p.D.T @ p.D
    rest = gram - (q.T @ p.D).T @ (q.T @ p.D)
    # a map that nothing answers to (a model that has run into its bounds) has a gram of zeros
    gram = gram + max(1e-6 * float(np.trace(gram)) / len(gram), 1e-300) * np.eye(len(gram))
    low = np.linalg.cholesky(gram)
    inverse = np.linalg.inv(low)
    share, u = np.linalg.eigh(inverse @ rest @ inverse.T)
    V = inverse.T @ u[:, share > SAME]
    k = p.J.shape[1]
    # along the axes of the roughness: what is smooth is then not lost beside a large penalty of the rest
    V = V / (np.linalg.norm(p.D @ V, axis=0) + 1e-300)
    bends, turn = np.linalg.eigh((p.S @ V).T @ (p.S @ V))
    V = V @ turn
    X = np.column_stack([p.J / (np.linalg.norm(p.J, axis=0) + 1e-300), p.D @ V])
    rough, bent = np.zeros(X.shape[1]), np.zeros(X.shape[1])
    rough[k:] = np.where(bends > ROUNDING * bends.max(initial=0.0), bends, 0.0)
    bent[k:] = np.where(rough[k:] > 0.0, V.T @ (p.S.T @ (p.S @ p.c)), 0.0)
    scale = 1.0 / max(float(np.mean(bends)) if len(bends) else 0.0, 1e-290)
    grams = [X[p.fold == f].T @ X[p.fold == f] for f in range(-1, FOLDS)]
    slopes = [X[p.fold == f].T @ p.r[p.fold == f] for f in range(-1, FOLDS)]
    squares = [float(p.r[p.fold == f] @ p.r[p.fold == f]) for f in range(FOLDS)]
    total_gram, total_slope = sum(grams), sum(slopes)
    # in half decades, from what changes no coefficient to what rounding leaves of one
    decades = round(-math.log10(ROUNDING))
    penalties = 10.0 ** np.arange(-decades, decades + 0.5, 0.5)
    costs = np.zeros(len(penalties))
    for i, penalty in enumerate(penalties):
        for f in range(FOLDS):
            b = _ridged(total_gram - grams[f + 1], penalty * scale * rough, total_slope - slopes[f + 1] + penalty * scale * bent)
            costs[i] += squares[f] + 2 * float(slopes[f + 1] @ b) + float(b @ grams[f + 1] @ b)
    best = int(np.argmin(costs))
    penalty = float(penalties[best] * scale)
    b = _ridged(total_gram, penalty * rough, total_slope + penalty * bent)
    return Solution(penalty, float(costs[best] / max(without, 1e-300)), V, p.c + V @ b[k:])


def _ridged(gram: np.ndarray, penalties: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Coefficients (k,) of least squares by its normal equations, each with a penalty of its own (k,).

    A ridge of sqrt(ROUNDING) of a column's square is added: what the other stretches do not show stays zero.
    """
    A = gram + np.diag(penalties + math.sqrt(ROUNDING))
    size = np.sqrt(np.diag(A))
    return np.asarray(-np.linalg.solve(A / np.outer(size, size), slope / size) / size)
