"""The prediction-error criterion, its analytic gradient and the Levenberg-Marquardt search, compiled.

Parameters: theta = [a, b, c, d, f, i, k] with the numbers of coefficients in ``n = (na, nb, nc, nd, nf, ni, nq)``. The
predictor is

    w = (B u + I delta) / F        v = A y - w        C e = D v + K delta

with delta the unit pulse at the first sample; I and K carry the initial conditions. The gradient of e is made of lagged signals
(Ljung, section 10.3)::

    de/da_i =  (D/C) y(t-i)         de/dc_i = -(1/C) e(t-i)       de/db_i = -(D/CF) u(t-nk-i)
    de/df_i =  (D/CF) w(t-i)        de/dd_i =  (1/C) v(t-i)       de/dI_i = -(D/CF) delta(t-i)     de/dK_i = (1/C) delta(t-i)
"""

from __future__ import annotations

import numpy as np

from ident.kernel import _fold, factor_lags, is_stable, solve_upper
from mjsim.compiled import compiled
from mjsim.signals import filter_into

__all__ = ["MARGIN", "factor", "residual", "search"]

MARGIN = 1e-7
"""C and F keep their roots within 1 - MARGIN, so that predictor and model stay stable."""


CURB = 1e-6
"""Moving an unconstrained coordinate of C or F by one is worth at least this relative loss: coordinates at the limit stay put."""


@compiled()
def _copy(source: np.ndarray, start: int, target: np.ndarray, to: int, count: int) -> None:
    """Copy ``count`` numbers; a slice that is set compiles the texts of its errors as well."""
    for i in range(count):
        target[to + i] = source[start + i]


@compiled()
def _polynomials(
    theta: np.ndarray, n: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C, D, F, I, K out of theta."""
    pos = 0
    a = np.ones(n[0] + 1)
    _copy(theta, pos, a, 1, n[0])
    pos += n[0]
    b = theta[pos : pos + n[1]].copy()
    pos += n[1]
    c = np.ones(n[2] + 1)
    _copy(theta, pos, c, 1, n[2])
    pos += n[2]
    d = np.ones(n[3] + 1)
    _copy(theta, pos, d, 1, n[3])
    pos += n[3]
    f = np.ones(n[4] + 1)
    _copy(theta, pos, f, 1, n[4])
    pos += n[4]
    i = theta[pos : pos + n[5]].copy()
    pos += n[5]
    k = theta[pos : pos + n[6]].copy()
    return a, b, c, d, f, i, k


@compiled()
def _add_free_response(coefficients: np.ndarray, den: np.ndarray, out: np.ndarray) -> None:
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


@compiled()
def residual(
    theta: np.ndarray, n: np.ndarray, nk: int, u: np.ndarray, y: np.ndarray, w: np.ndarray, v: np.ndarray, e: np.ndarray,
    radius: np.ndarray
) -> float:  # fmt: skip
    """Fill w, v, e and return the sum of squares of e, or infinity when C or F is not stable."""
    a, b, c, d, f, i, k = _polynomials(theta, n)
    if not (is_stable(c, 0.2 * (1.0 - radius[2])) and is_stable(f, 0.2 * (1.0 - radius[4]))):
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


@compiled()
def factor(
    theta: np.ndarray, n: np.ndarray, nk: int, u: np.ndarray, y: np.ndarray, w: np.ndarray, v: np.ndarray, e: np.ndarray,
    signals: np.ndarray, pulse: np.ndarray
) -> np.ndarray:  # fmt: skip
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
    r: np.ndarray = factor_lags(signals, sign, first, n, e, 0)
    return r


@compiled()
def _reduced(r: np.ndarray, free: np.ndarray) -> np.ndarray:
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


@compiled()
def to_reflection(poly: np.ndarray, radius: float) -> np.ndarray:
    """Unconstrained coordinates x, shape (order,), of a monic polynomial with its roots within ``radius``.

    atanh of the reflection coefficients (step-down recursion) of the polynomial with its roots divided by ``radius``.
    """
    n = poly.size - 1
    a = poly.copy()
    for i in range(n + 1):
        a[i] /= radius**i
    x = np.zeros(n)
    b = np.empty(n + 1)
    for m in range(n, 0, -1):
        k = min(max(a[m], -1.0 + 1e-15), 1.0 - 1e-15)
        x[m - 1] = np.arctanh(k)
        g = 1.0 - k * k
        for i in range(m):
            b[i] = (a[i] - k * a[m - i]) / g
        for i in range(m):
            a[i] = b[i]
    return x


@compiled()
def from_reflection(x: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Inverse of ``to_reflection`` (step-up), with the Jacobian of the coefficients 1 .. order, shape (order, order)."""
    n = x.size
    a = np.zeros(n + 1)
    a[0] = 1.0
    jac = np.zeros((n + 1, n))
    old = np.zeros(n + 1)
    old_jac = np.zeros((n + 1, n))
    for m in range(1, n + 1):
        k = np.tanh(x[m - 1])
        for i in range(m + 1):
            old[i] = a[i]
            for j in range(n):
                old_jac[i, j] = jac[i, j]
        for i in range(1, m + 1):
            a[i] = old[i] + k * old[m - i]
            for j in range(m - 1):
                jac[i, j] = old_jac[i, j] + k * old_jac[m - i, j]
            jac[i, m - 1] = old[m - i] * (1.0 - k * k)
    for i in range(1, n + 1):
        a[i] *= radius**i
        for j in range(n):
            jac[i, j] *= radius**i
    return a, jac[1:]


@compiled()
def _place(n: np.ndarray, which: int) -> int:
    pos = 0
    for s in range(which):
        pos += n[s]
    return pos


@compiled()
def encode(theta: np.ndarray, n: np.ndarray, free: np.ndarray, mapped: bool, radius: np.ndarray) -> np.ndarray:
    """Coordinates of the search: theta itself, or with C and F in their unconstrained coordinates if ``mapped``."""
    x = theta.copy()
    if mapped:
        for which in (2, 4):
            order, pos = n[which], _place(n, which)
            if order and free[pos]:
                poly = np.ones(order + 1)
                _copy(theta, pos, poly, 1, order)
                x[pos : pos + order] = to_reflection(poly, radius[which])
    return x


@compiled()
def decode(x: np.ndarray, n: np.ndarray, free: np.ndarray, mapped: bool, radius: np.ndarray) -> np.ndarray:
    """Inverse of ``encode``."""
    theta = x.copy()
    if mapped:
        for which in (2, 4):
            order, pos = n[which], _place(n, which)
            if order and free[pos]:
                poly, _ = from_reflection(x[pos : pos + order], radius[which])
                _copy(poly, 1, theta, pos, order)
    return theta


@compiled()
def _in_coordinates(r: np.ndarray, x: np.ndarray, n: np.ndarray, free: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The factor with the columns of C and F replaced by those of their unconstrained coordinates."""
    out = r.copy()
    for which in (2, 4):
        order, pos = n[which], _place(n, which)
        if order == 0 or not free[pos]:
            continue
        _, jac = from_reflection(x[pos : pos + order], radius[which])
        for i in range(r.shape[0]):
            for j in range(order):
                s = 0.0
                for k in range(order):
                    s += r[i, pos + k] * jac[k, j]
                out[i, pos + j] = s
    block = np.ascontiguousarray(out.T)
    small = np.zeros_like(r)
    _fold(small, block, r.shape[0])
    return small


@compiled()
def search(
    theta: np.ndarray, n: np.ndarray, nk: int, u: np.ndarray, y: np.ndarray, free: np.ndarray, max_iterations: int,
    tolerance: float, mapped: bool, radius: np.ndarray
) -> tuple[np.ndarray, float, int, int, float, np.ndarray]:  # fmt: skip
    """Levenberg-Marquardt from theta over the parameters with free[j] != 0.

    ``radius``: largest root radius per polynomial (7,), read for C and F. ``mapped``: search C and F in coordinates in which
    every point is stable, so that the search can follow the limit of stability instead of stopping at it.

    Returns theta, its sum of squares, iterations, status (0 converged, 1 iteration limit, 2 no further descent, 3 start
    unstable), the relative loss decrease that a further step predicts, and the full factor R at the end.
    """
    p = theta.size
    samples = y.size
    w, v, e = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    signals = np.zeros((8, samples))
    pulse = np.zeros(samples)
    pulse[0] = 1.0
    x = encode(theta, n, free, mapped, radius)
    theta = theta.copy()
    loss = residual(theta, n, nk, u, y, w, v, e, radius)
    if not np.isfinite(loss):
        return theta, loss, 0, 3, np.inf, np.zeros((p + 1, p + 1))
    m = 0
    for j in range(p):
        m += free[j]
    curbed = np.zeros(m)
    if mapped:
        col = 0
        for j in range(p):
            if free[j]:
                for which in (2, 4):
                    pos = _place(n, which)
                    if pos <= j < pos + n[which]:
                        curbed[col] = 1.0
                col += 1
    mu, grow = 1e-4, 2.0
    status, iteration, flat = 1, 0, 0
    predicted = np.inf
    new = loss
    trial = theta
    trial_x = x
    r = factor(theta, n, nk, u, y, w, v, e, signals, pulse)
    for _ in range(max_iterations):
        small = _reduced(_in_coordinates(r, x, n, free, radius) if mapped else r, free)
        scale = np.empty(m)
        for j in range(m):
            s = 0.0
            for i in range(j + 1):
                s += small[i, j] * small[i, j]
            scale[j] = np.sqrt(s) if s > 0.0 else 1.0
            if curbed[j] > 0.0:
                scale[j] = max(scale[j], 1e-3 * np.sqrt(loss))
        explained = 0.0
        for i in range(m):
            explained += small[i, m] * small[i, m]
        predicted = explained / loss if loss > 0.0 else 0.0
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
                damp[j, j] = np.sqrt(mu + curbed[j] * CURB * loss / scale[j] ** 2)
            _fold(work, damp, m)
            step = np.zeros(m)
            solve_upper(work, m, work[:m, m].copy(), step)
            model = 0.0  # decrease of the sum of squares that the linear model promises
            for i in range(m):
                s = 0.0
                for j in range(i, m):
                    s += small[i, j] / scale[j] * step[j]
                model += small[i, m] * small[i, m] - (small[i, m] - s) ** 2
            trial_x = x.copy()
            col = 0
            for j in range(p):
                if free[j]:
                    trial_x[j] -= step[col] / scale[col]
                    col += 1
            trial = decode(trial_x, n, free, mapped, radius)
            new = residual(trial, n, nk, u, y, w, v, e, radius)
            if new < loss:
                gain = (loss - new) / model if model > 0.0 else 0.0
                mu *= max(1.0 / 10.0, 1.0 - (2.0 * gain - 1.0) ** 3) if gain < 1.5 else 1.0
                mu = max(mu, 1e-15)
                grow = 2.0
                accepted = True
                break
            mu *= grow
            grow = min(2.0 * grow, 16.0)
            if mu > 1e12:
                break
        if not accepted:
            residual(theta, n, nk, u, y, w, v, e, radius)
            status = 0 if predicted < 1e3 * tolerance else 2
            break
        flat = flat + 1 if loss - new < max(tolerance, 1e-6 if mapped else 0.0) * loss else 0
        loss, theta, x = new, trial, trial_x
        r = factor(theta, n, nk, u, y, w, v, e, signals, pulse)
        if flat >= 10:
            status = 2
            break
    return theta, loss, iteration, status, predicted, r
