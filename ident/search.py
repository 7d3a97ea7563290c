"""The prediction-error criterion, its analytic gradient and the Levenberg-Marquardt search, compiled.

Parameters: theta = [a, b, c, d, f, i, k] with the numbers of coefficients in ``n = (na, nb, nc, nd, nf, ni, nq)``. The predictor is

    w = (B u + I delta) / F        v = A y - w        C e = D v + K delta

with delta the unit pulse at the first sample; I and K carry the initial conditions. The gradient of e is made of lagged signals
(Ljung, section 10.3)::

    de/da_i =  (D/C) y(t-i)         de/dc_i = -(1/C) e(t-i)       de/db_i = -(D/CF) u(t-nk-i)
    de/df_i =  (D/CF) w(t-i)        de/dd_i =  (1/C) v(t-i)       de/dI_i = -(D/CF) delta(t-i)     de/dK_i = (1/C) delta(t-i)
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ident.kernel import _fold, factor_lags, filter_into, is_stable, solve_upper

__all__ = ["MARGIN", "factor", "residual", "search"]

MARGIN = 1e-7
"""C and F keep their roots within 1 - MARGIN, so that predictor and model stay stable."""


@njit(cache=True, nogil=True)
def _polynomials(theta, n):
    """A, B, C, D, F, I, K out of theta."""
    pos = 0
    a = np.ones(n[0] + 1)
    a[1:] = theta[pos : pos + n[0]]
    pos += n[0]
    b = theta[pos : pos + n[1]].copy()
    pos += n[1]
    c = np.ones(n[2] + 1)
    c[1:] = theta[pos : pos + n[2]]
    pos += n[2]
    d = np.ones(n[3] + 1)
    d[1:] = theta[pos : pos + n[3]]
    pos += n[3]
    f = np.ones(n[4] + 1)
    f[1:] = theta[pos : pos + n[4]]
    pos += n[4]
    i = theta[pos : pos + n[5]].copy()
    pos += n[5]
    k = theta[pos : pos + n[6]].copy()
    return a, b, c, d, f, i, k


@njit(cache=True, nogil=True)
def _add_free_response(coefficients, den, out):
    """out += (coefficients delta) / den, cut off once it has decayed."""
    m = coefficients.size
    nd = den.size - 1
    if m == 0:
        return
    n = out.size
    free = np.zeros(n)
    quiet = 0
    top = 0.0
    for t in range(n):
        s = coefficients[t] if t < m else 0.0
        for i in range(1, min(nd, t) + 1):
            s -= den[i] * free[t - i]
        free[t] = s
        out[t] += s
        top = max(top, abs(s))
        quiet = quiet + 1 if abs(s) <= 1e-17 * top else 0
        if t >= m and quiet > nd:
            break


@njit(cache=True, nogil=True)
def residual(theta, n, nk, u, y, w, v, e):
    """Fill w, v, e and return the sum of squares of e, or infinity when C or F is not stable."""
    a, b, c, d, f, i, k = _polynomials(theta, n)
    if not (is_stable(c, MARGIN) and is_stable(f, MARGIN)):
        return np.inf
    one = np.ones(1)
    filter_into(b, nk, f, u, w)
    _add_free_response(i, f, w)
    filter_into(a, 0, one, y, v)
    for t in range(v.size):
        v[t] -= w[t]
    filter_into(d, 0, c, v, e)
    _add_free_response(k, c, e)
    s = 0.0
    for t in range(e.size):
        s += e[t] * e[t]
    return s if np.isfinite(s) else np.inf


@njit(cache=True, nogil=True)
def factor(theta, n, nk, u, y, w, v, e, signals, pulse):
    """Triangular factor (p+1, p+1) of [de/dtheta, e] at theta, whose w, v, e are given."""
    _, _, c, d, f, _, _ = _polynomials(theta, n)
    one = np.ones(1)
    tmp = signals[7]
    if n[0] > 0:
        filter_into(d, 0, c, y, signals[0])
    filter_into(d, 0, c, u, tmp)
    filter_into(one, 0, f, tmp, signals[1])
    if n[2] > 0:
        filter_into(one, 0, c, e, signals[2])
    if n[3] > 0:
        filter_into(one, 0, c, v, signals[3])
    if n[4] > 0:
        filter_into(d, 0, c, w, tmp)
        filter_into(one, 0, f, tmp, signals[4])
    if n[5] > 0:
        filter_into(d, 0, c, pulse, tmp)
        filter_into(one, 0, f, tmp, signals[5])
    if n[6] > 0:
        filter_into(one, 0, c, pulse, signals[6])
    sign = np.array([1.0, -1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    first = np.array([1, nk, 1, 1, 1, 0, 0])
    return factor_lags(signals, sign, first, n, e, 0)


@njit(cache=True, nogil=True)
def _reduced(r, free):
    """The factor with only the columns of the free parameters (and e) kept."""
    p = r.shape[0] - 1
    m = 0
    for j in range(p):
        m += free[j]
    if m == p:
        return r.copy()
    block = np.zeros((m + 1, p + 1))
    col = 0
    for j in range(p + 1):
        if j == p or free[j]:
            for i in range(j + 1):
                block[col, i] = r[i, j]
            col += 1
    out = np.zeros((m + 1, m + 1))
    _fold(out, block, p + 1)
    return out


@njit(cache=True, nogil=True)
def search(theta, n, nk, u, y, free, max_iterations, tolerance):
    """Levenberg-Marquardt from theta over the parameters with free[j] != 0.

    Returns theta, its sum of squares, iterations, status (0 converged, 1 iteration limit, 2 no further descent, 3 start unstable),
    the relative loss decrease that a further step predicts, and the full factor R at the end.
    """
    p = theta.size
    samples = y.size
    w, v, e = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    signals = np.zeros((8, samples))
    pulse = np.zeros(samples)
    pulse[0] = 1.0
    theta = theta.copy()
    loss = residual(theta, n, nk, u, y, w, v, e)
    if not np.isfinite(loss):
        return theta, loss, 0, 3, np.inf, np.zeros((p + 1, p + 1))
    m = 0
    for j in range(p):
        m += free[j]
    mu, grow = 1e-4, 2.0
    status, iteration = 1, 0
    predicted = np.inf
    r = factor(theta, n, nk, u, y, w, v, e, signals, pulse)
    flat = 0
    for _ in range(max_iterations):
        small = _reduced(r, free)
        scale = np.empty(m)
        for j in range(m):
            s = 0.0
            for i in range(j + 1):
                s += small[i, j] * small[i, j]
            scale[j] = np.sqrt(s) if s > 0.0 else 1.0
        total = 0.0
        explained = 0.0
        for i in range(m + 1):
            total += small[i, m] * small[i, m]
            if i < m:
                explained += small[i, m] * small[i, m]
        predicted = explained / total if total > 0.0 else 0.0
        if predicted < tolerance:
            status = 0
            break
        iteration += 1
        accepted = False
        for _attempt in range(40):
            work = np.zeros((m + 1, m + 1))
            for i in range(m + 1):
                for j in range(i, m + 1):
                    work[i, j] = small[i, j] / (scale[j] if j < m else 1.0)
            damp = np.zeros((m + 1, m))
            for j in range(m):
                damp[j, j] = np.sqrt(mu)
            _fold(work, damp, m)
            step = np.zeros(m)
            solve_upper(work, m, work[:m, m].copy(), step)
            model = 0.0  # decrease of the sum of squares that the linear model promises
            for i in range(m):
                s = 0.0
                for j in range(i, m):
                    s += small[i, j] / scale[j] * step[j]
                model += small[i, m] * small[i, m] - (small[i, m] - s) ** 2
            trial = theta.copy()
            col = 0
            for j in range(p):
                if free[j]:
                    trial[j] -= step[col] / scale[col]
                    col += 1
            new = residual(trial, n, nk, u, y, w, v, e)
            if new < loss:
                gain = (loss - new) / model if model > 0.0 else 0.0
                mu *= max(1.0 / 10.0, 1.0 - (2.0 * gain - 1.0) ** 3) if gain < 1.5 else 1.0
                mu = max(mu, 1e-15)
                grow = 2.0
                accepted = True
                break
            mu *= grow
            grow *= 2.0
            if mu > 1e16:
                break
        if not accepted:
            residual(theta, n, nk, u, y, w, v, e)
            status = 0 if predicted < 1e3 * tolerance else 2
            break
        flat = flat + 1 if loss - new < 1e-3 * tolerance * loss else 0
        loss = new
        theta = trial
        r = factor(theta, n, nk, u, y, w, v, e, signals, pulse)
        if flat >= 8:
            status = 2
            break
    return theta, loss, iteration, status, predicted, r
