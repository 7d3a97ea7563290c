"""Symmetric positive definite systems whose entries differ by many orders of magnitude.

The curvature of a barrier next to its wall is some 1e15 times that of the prior, so that rounding alone makes the computed
matrix indefinite. H is scaled to a unit diagonal first, which leaves an error of K eps for each eigenvalue (K: number of
unknowns); eigenvalues below are set to it. Cholesky's factorisation is used wherever it exists. An unknown whose diagonal
entry is not positive is not determined: it is 0 in every solution.
Sources: A. van der Sluis, Numer. Math. 14 (1969) 14; N. J. Higham, Accuracy and Stability of Numerical Algorithms (2002), ch. 10.
"""

from __future__ import annotations

import numpy as np

__all__ = ["inverse", "inverse_root", "solved"]


def solved(H: np.ndarray, b: np.ndarray) -> np.ndarray:
    """x of H x = b; H (K, K) symmetric and positive definite up to rounding, b (K,) or (K, m)."""
    W = inverse_root(H)
    return np.asarray(W @ (W.T @ b))


def inverse(H: np.ndarray) -> np.ndarray:
    """Inverse (K, K) of H, symmetric."""
    W = inverse_root(H)
    return np.asarray(W @ W.T)


def inverse_root(H: np.ndarray) -> np.ndarray:
    """W (K, K) with W W' = H^-1."""
    from scipy.linalg import solve_triangular

    diagonal = np.diag(H)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    unit = H * np.outer(scale, scale)
    try:
        lower = np.linalg.cholesky(unit)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(0.5 * (unit + unit.T))
        least = max(len(values) * np.finfo(float).eps * float(values[-1]), float(np.finfo(float).tiny))
        return np.asarray(scale[:, None] * vectors / np.sqrt(np.maximum(values, least)))
    return np.asarray(scale[:, None] * solve_triangular(lower, np.eye(len(lower)), lower=True).T)
