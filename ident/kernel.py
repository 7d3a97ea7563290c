"""A least-squares factor built block by block, compiled.

Linear in the number of samples in time and memory: a regression on lagged signals is reduced to its triangular factor R a block
of rows at a time, so that the N x n matrix never exists.
"""

from __future__ import annotations

import numpy as np

from mjsim.compiled import compiled

__all__ = ["factor_lags", "is_stable", "least_squares", "solve_upper"]

BLOCK = 512
_FAST = {"reassoc", "contract", "arcp", "nsz"}


@compiled()
def is_stable(poly: np.ndarray, margin: float) -> bool:
    """Whether all roots of the monic polynomial lie within radius 1 - margin (Schur-Cohn step-down test)."""
    n = poly.size - 1
    a = np.empty(n + 1)
    scale = 1.0
    for i in range(n + 1):
        a[i] = poly[i] * scale
        scale /= 1.0 - margin
    b = np.empty(n + 1)
    for m in range(n, 0, -1):
        k = a[m]
        if not abs(k) < 1.0:
            return False
        g = 1.0 - k * k
        for i in range(m):
            b[i] = (a[i] - k * a[m - i]) / g
        for i in range(m):
            a[i] = b[i]
    return True


@compiled(fastmath=_FAST)
def _fold(r: np.ndarray, block: np.ndarray, rows: int) -> None:
    """Householder update: r (p, p) upper becomes the factor of [r; block.T]; ``block`` (p, rows) is overwritten."""
    p = r.shape[0]
    for j in range(p):
        x = block[j]
        s = 0.0
        for t in range(rows):
            s += x[t] * x[t]
        if s == 0.0:
            continue
        norm = np.sqrt(r[j, j] * r[j, j] + s)
        alpha = -norm if r[j, j] > 0.0 else norm
        v0 = r[j, j] - alpha
        tau = 2.0 / (v0 * v0 + s)
        r[j, j] = alpha
        for k in range(j + 1, p):
            z = block[k]
            d = v0 * r[j, k]
            for t in range(rows):
                d += x[t] * z[t]
            d *= tau
            r[j, k] -= d * v0
            for t in range(rows):
                z[t] -= d * x[t]


@compiled()
def factor_lags(
    signals: np.ndarray, sign: np.ndarray, first_lag: np.ndarray, n_lags: np.ndarray, target: np.ndarray, start: int
) -> np.ndarray:
    """Triangular factor R (p+1, p+1) of the regression matrix [lagged signals, target], rows start .. N-1.

    Column (s, i) is ``sign[s] * signals[s](t - first_lag[s] - i)``, i = 0 .. n_lags[s] - 1, zero before the first sample.
    """
    n = target.size
    p = 1
    for s in range(n_lags.size):
        p += n_lags[s]
    r = np.zeros((p, p))
    block = np.empty((p, BLOCK))
    for begin in range(start, n, BLOCK):
        rows = min(BLOCK, n - begin)
        col = 0
        for s in range(n_lags.size):
            for i in range(n_lags[s]):
                shift = begin - first_lag[s] - i
                lead = min(max(0, -shift), rows)
                for t in range(lead):
                    block[col, t] = 0.0
                for t in range(lead, rows):
                    block[col, t] = sign[s] * signals[s, shift + t]
                col += 1
        for t in range(rows):
            block[col, t] = target[begin + t]
        _fold(r, block, rows)
    return r


@compiled()
def solve_upper(r: np.ndarray, n: int, rhs: np.ndarray, out: np.ndarray) -> None:
    """Back substitution ``r[:n, :n] out = rhs``; a vanishing pivot gives a zero."""
    top = 0.0
    for j in range(n):
        top = max(top, abs(r[j, j]))
    for i in range(n - 1, -1, -1):
        s = rhs[i]
        for k in range(i + 1, n):
            s -= r[i, k] * out[k]
        out[i] = s / r[i, i] if abs(r[i, i]) > 1e-14 * top else 0.0


@compiled()
def least_squares(r: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients and residual sum of squares of the regression behind a factor of ``factor_lags``."""
    p = r.shape[0] - 1
    out = np.zeros(p)
    # equilibrated, lightly damped at rounding level: columns that repeat each other share the coefficient
    scale = np.empty(p)
    for j in range(p):
        s = 0.0
        for i in range(j + 1):
            s += r[i, j] * r[i, j]
        scale[j] = np.sqrt(s) if s > 0.0 else 1.0
    work = np.zeros((p + 1, p + 1))
    for i in range(p + 1):
        for j in range(i, p + 1):
            work[i, j] = r[i, j] / (scale[j] if j < p else 1.0)
    damp = np.zeros((p + 1, p))
    for j in range(p):
        damp[j, j] = 1e-13
    _fold(work, damp, p)
    solve_upper(work, p, work[:p, p].copy(), out)
    for j in range(p):
        out[j] /= scale[j]
    return out, r[p, p] * r[p, p]
