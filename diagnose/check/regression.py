"""Least squares with one unknown delay: a signal, some time ago, as a sum of columns, with a whitened residual.

    y(t - delay) = sum_i b_i x_i(t) + e(t)

The residual is whitened by an autoregression in turns with the fit. The delay is found on a grid and refined by Gauss-Newton, so
that its standard error comes from the same covariance as those of the coefficients. Source: L. Ljung, System Identification
(1999) ch. 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

__all__ = ["Solution", "regress"]

_ORDER = 8  # of the autoregression: two resonances and two real poles of the residual
_STEPS = 8.0  # grid points of the delay per period of the highest frequency
_RIDGE = 1e-9  # relative, for collinear columns
_TURNS = 3  # of whitening and fit: the filter no longer changes


@dataclass(frozen=True, eq=False)
class Solution:
    """Delay [s] and standard error; coefficients (k,) and covariance (k, k); whitening filter; prior precisions (k,); plain
    and whitened residuals; target (M,); which rows count (M,)."""

    delay: float
    delay_error: float
    coefficients: np.ndarray
    covariance: np.ndarray
    filters: np.ndarray
    prior: np.ndarray
    residual: np.ndarray
    white: np.ndarray
    target: np.ndarray
    keep: np.ndarray

    @property
    def explained(self) -> float:
        """Part of the target's variance in the rows that count."""
        return 1.0 - float(np.mean(self.residual[self.keep] ** 2)) / max(float(np.var(self.target[self.keep])), 1e-300)


def regress(
    X: np.ndarray,
    target: Callable[[float | np.ndarray], np.ndarray],
    window: tuple[float, float],
    top: float,
    prior: np.ndarray | None = None,
    keep: np.ndarray | None = None,
    *,
    fixed: bool = False,
) -> Solution:
    """Fit the columns X (M, k) to ``target(delay)`` (M,), or (M, G) for delays (G,), for delays within ``window`` [s]; ``top``
    [Hz]: the band's upper end.

    ``prior`` (k,): precisions of the coefficients about 0; ``keep`` (M,) bool: the rows that count. A row counts when those that
    the whitening filter takes with it do as well; ``fixed``: the delay is the middle of the window.
    """
    prior = np.zeros(X.shape[1]) if prior is None else prior
    keep = np.ones(len(X), bool) if keep is None else keep
    free = prior == 0
    grid = np.arange(window[0], window[1] + 1e-12, 1 / (_STEPS * top))
    shifted = target(grid)
    delay, filters = 0.5 * (window[0] + window[1]), np.ones(1)
    for turn in range(_TURNS):
        filters = _autoregression(solve(X, target(delay), np.ones(1), prior, keep)[1])
        counts = _counted(keep, filters)
        basis = np.linalg.qr(filtered(X if turn else X[:, free], filters)[counts])[0]
        Y = filtered(shifted, filters)[counts]
        delay = delay if fixed else float(grid[int(np.argmin(np.sum(Y**2, axis=0) - np.sum((basis.T @ Y) ** 2, axis=0)))])
    h, limit, error = 1e-3 / top, 1 / (_STEPS * top), math.nan
    for _ in range(0 if fixed else 4):
        slope = (target(delay - h) - target(delay + h)) / (2 * h)
        b, _, covariance = solve(np.column_stack([X, slope]), target(delay), filters, np.append(prior, 0.0), keep)
        error = math.sqrt(max(float(covariance[-1, -1]), 0.0))
        delay += min(max(float(b[-1]), -limit), limit)
    y = target(delay)
    b, white, covariance = solve(X, y, filters, prior, keep)
    return Solution(delay, error, b, covariance, filters, prior, y - X @ b, white, y, keep)


def solve(
    X: np.ndarray, y: np.ndarray, filters: np.ndarray, prior: np.ndarray | None = None, keep: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (k,), whitened residual and covariance (k, k) of the whitened least squares; ``prior``: precisions about 0.

    The residual has zeros in the rows that do not count (``keep``).
    """
    Xw, yw = filtered(X, filters), filtered(y[:, None], filters)[:, 0]
    counts = np.ones(len(yw), bool) if keep is None else _counted(keep, filters)
    everything, Xw, yw = len(yw), Xw[counts], yw[counts]
    scale = np.sqrt(np.mean(Xw**2, axis=0)) + 1e-300
    A = Xw / scale
    gram, ridge = A.T @ A, _RIDGE * len(A) * np.eye(A.shape[1])
    inverse, variance = np.linalg.inv(gram + ridge), 0.0
    for _ in range(1 if prior is None or not prior.any() else 3):  # the prior is weighed by the variance that it leaves
        b = inverse @ (A.T @ yw)
        white = yw - A @ b
        variance = float(white @ white) / max(len(A) - A.shape[1] - 1, 1)
        if prior is not None and prior.any():
            inverse = np.linalg.inv(gram + ridge + variance * np.diag(prior / scale**2))
    b = inverse @ (A.T @ yw)
    white = np.zeros(everything)
    white[counts] = yw - A @ b
    return b / scale, white, variance * inverse / np.outer(scale, scale)


def _counted(keep: np.ndarray, filters: np.ndarray) -> np.ndarray:
    """Rows (M - p,) of a filtered column that take no row with them that does not count."""
    complete: np.ndarray = filtered((~keep).astype(float)[:, None], np.ones(len(filters)))[:, 0] == 0
    return complete


def _autoregression(residual: np.ndarray) -> np.ndarray:
    """Whitening filter (p + 1,) of a residual, by least squares with a small ridge; [1] where it is too short."""
    p = min(_ORDER, len(residual) // 20)
    power = float(residual @ residual)
    if p < 1 or power == 0:
        return np.ones(1)
    lagged = np.lib.stride_tricks.sliding_window_view(residual, p)[:-1][:, ::-1]
    gram = lagged.T @ lagged + 1e-6 * power * np.eye(p)
    return np.concatenate([[1.0], -np.linalg.solve(gram, lagged.T @ residual[p:])])


def filtered(columns: np.ndarray, filters: np.ndarray) -> np.ndarray:
    """Each column (M, k) through a whitening filter (p + 1,), without the p samples at which it starts."""
    p = len(filters) - 1
    out = filters[0] * columns[p:]
    for i in range(1, p + 1):
        out = out + filters[i] * columns[p - i : len(columns) - i]
    return np.asarray(out)
