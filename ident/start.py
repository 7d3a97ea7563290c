"""Initial values: several independent routes to a first model, so that the search need not find its way out of a wrong valley.

Routes to the plant B/F:

* ``whitened``: a high-order ARX model whitens the noise; Steiglitz-McBride on data filtered by its A polynomial
  (Box-Jenkins Steiglitz-McBride: Zhu & Hjalmarsson, Automatica 2016; asymptotically efficient in open loop);
* ``denoised``: Steiglitz-McBride on the output that the high-order ARX model simulates (Everitt et al., MORSM, Automatica 2018);
* ``steiglitz``: Steiglitz-McBride on the raw data (Stoica & Soderstrom, 1981);
* ``instrumental``: least squares, then simulated-input instruments on whitened data (IV4: Ljung, section 15.3);
* ``least_squares``: low-order ARX.

The noise model C/D then comes from what the plant leaves over: a long autoregression gives innovations, a regression on lags
of both gives C and D (Hannan-Rissanen, 1982; Durbin, 1960).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ident.kernel import factor_lags, is_stable, least_squares
from ident.structure import Structure
from mjsim.signals import lfilter

__all__ = ["first_models", "noise_model"]

_ONE = np.ones(1)


def stabilised(poly: np.ndarray, radius: float = 0.999) -> np.ndarray:
    """Monic polynomial whose roots outside ``radius`` are reflected into the circle, then held at ``radius``."""
    if is_stable(poly, 1.0 - radius):
        return poly
    roots = np.roots(poly)
    size = np.abs(roots)
    outside = size > 1.0
    roots[outside] = 1.0 / np.conj(roots[outside])
    size = np.abs(roots)
    over = size > radius
    roots[over] *= radius / size[over]
    return np.real(np.poly(roots))


def _arx(u: np.ndarray, y: np.ndarray, na: int, nb: int, nk: int) -> tuple[np.ndarray, np.ndarray]:
    """Least squares ``A y = B u``: A monic (na+1,), B (nb,)."""
    start = min(max(na, nb + nk - 1), y.size - 1)
    factor = factor_lags(np.stack([y, u]), np.array([-1.0, 1.0]), np.array([1, nk]), np.array([na, nb]), y, start)
    theta, _ = least_squares(factor)
    return np.r_[1.0, theta[:na]], theta[na:]


def _products(x: np.ndarray, z: np.ndarray, n: int, first_x: int, first_z: int, start: int) -> np.ndarray:
    """M[i, j] = sum over t >= start of x(t - first_x - i) z(t - first_z - j), (n, n), by first row, first column and end
    corrections."""
    size = x.size
    m = np.empty((n, n))

    def at(a: np.ndarray, lag: int) -> np.ndarray:
        return a[start - lag : size - lag]

    for j in range(n):
        m[0, j] = at(x, first_x) @ at(z, first_z + j)
        m[j, 0] = at(x, first_x + j) @ at(z, first_z)
    for i in range(1, n):
        ix, iz = first_x + i, first_z + np.arange(1, n)
        gained = x[start - ix] * z[start - iz]
        lost = x[size - ix] * z[size - iz] if ix > 0 else np.zeros(n - 1)
        m[i, 1:] = m[i - 1, :-1] + gained - lost
    return m


def _long_arx(u: np.ndarray, y: np.ndarray, order: int, nk: int) -> tuple[np.ndarray, np.ndarray]:
    """High-order ARX by accumulated products: O(N order), with a ridge at rounding level."""
    start = order + nk
    nb = order
    phi = np.empty((2 * order, 2 * order))
    phi[:order, :order] = _products(y, y, order, 1, 1, start)
    phi[:order, order:] = -_products(y, u, order, 1, nk, start) if nk >= 1 else -_products_direct(y, u, order, 1, nk, start)
    phi[order:, :order] = phi[:order, order:].T
    phi[order:, order:] = _products(u, u, order, nk, nk, start) if nk >= 1 else _products_direct(u, u, order, nk, nk, start)
    size = y.size
    rhs = np.empty(2 * order)
    for i in range(order):
        rhs[i] = -(y[start - 1 - i : size - 1 - i] @ y[start:])
        rhs[order + i] = u[start - nk - i : size - nk - i] @ y[start:]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(phi), 1e-300))
    theta = np.linalg.solve(phi * scale[:, None] * scale[None, :] + 1e-11 * np.eye(2 * order), rhs * scale) * scale
    return np.r_[1.0, theta[:order]], theta[order : order + nb]


def _products_direct(x: np.ndarray, z: np.ndarray, n: int, first_x: int, first_z: int, start: int) -> np.ndarray:
    size = x.size
    return np.array(
        [
            [x[start - first_x - i : size - first_x - i] @ z[start - first_z - j : size - first_z - j] for j in range(n)]
            for i in range(n)
        ]
    )


def _steiglitz(u: np.ndarray, y: np.ndarray, f: np.ndarray, nb: int, nk: int, loops: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Steiglitz-McBride from F: ARX on data filtered by 1/F, repeated; the iterate with the smallest output error is kept."""
    nf = f.size - 1
    best = (np.inf, f, np.zeros(nb))
    f = stabilised(f)
    for _ in range(loops):
        uf, yf = lfilter(_ONE, f, u), lfilter(_ONE, f, y)
        new, b = _arx(uf, yf, nf, nb, nk)
        new = stabilised(new)
        error = y - lfilter(b, new, u, nk)
        loss = float(error @ error)
        if np.isfinite(loss) and loss < best[0]:
            best = (loss, new, b)
        if np.max(np.abs(new - f)) < 1e-7 * np.max(np.abs(f)):
            break
        f = new
    return best[1], best[2]


def _instrumental(
    u: np.ndarray, y: np.ndarray, f: np.ndarray, b: np.ndarray, whiten: np.ndarray, nk: int
) -> tuple[np.ndarray, np.ndarray]:
    """IV4's last step: instruments simulated by B/F, data and instruments filtered by ``whiten``."""
    nf, nb = f.size - 1, b.size
    x = lfilter(whiten, _ONE, lfilter(b, stabilised(f), u, nk))
    yf, uf = lfilter(whiten, _ONE, y), lfilter(whiten, _ONE, u)
    start, size = max(nf, nb + nk - 1), y.size

    def rows(first: np.ndarray) -> list[np.ndarray]:
        lagged = [-first[start - i : size - i] for i in range(1, nf + 1)]
        return lagged + [uf[start - nk - i : size - nk - i] for i in range(nb)]

    instruments, regressors = rows(x), rows(yf)
    m = np.array([[z @ p for p in regressors] for z in instruments])
    theta = np.linalg.lstsq(m, np.array([z @ yf[start:] for z in instruments]), rcond=1e-13)[0]
    return np.r_[1.0, theta[:nf]], theta[nf:]


def _numerator(u: np.ndarray, y: np.ndarray, f: np.ndarray, nb: int, nk: int, whiten: np.ndarray) -> np.ndarray:
    """B by least squares with F held, data filtered by ``whiten``."""
    uf = lfilter(whiten, f, u)
    yf = lfilter(whiten, _ONE, y)
    factor = factor_lags(uf[None, :], np.ones(1), np.array([nk]), np.array([nb]), yf, 0)
    solution: np.ndarray = least_squares(factor)[0]
    return solution


def noise_model(v: np.ndarray, nc: int, nd: int) -> tuple[np.ndarray, np.ndarray]:
    """C (nc+1,) and D (nd+1,) of ``D v = C e`` by Hannan-Rissanen, both stable."""
    if nc == 0 and nd == 0:
        return _ONE, _ONE
    size = v.size
    if nc == 0:
        factor = factor_lags(v[None, :], -np.ones(1), np.ones(1, int), np.array([nd]), v, nd)
        return _ONE, stabilised(np.r_[1.0, least_squares(factor)[0]])
    order = int(min(max(20, 3 * (nc + nd)), size // 8))
    lags = np.array([v[: size - k] @ v[k:] for k in range(order + 1)])
    if lags[0] <= 0.0:
        return np.r_[1.0, np.zeros(nc)], np.r_[1.0, np.zeros(nd)]
    lags[0] *= 1.0 + 1e-10
    from scipy.linalg import solve_toeplitz

    ar = np.r_[1.0, -solve_toeplitz(lags[:-1], lags[1:])]
    e = lfilter(ar, _ONE, v)
    factor = factor_lags(
        np.stack([e, v]), np.array([1.0, -1.0]), np.ones(2, int), np.array([nc, nd]), v, min(order + max(nc, nd), size // 2)
    )
    theta = least_squares(factor)[0]
    return stabilised(np.r_[1.0, theta[:nc]], 0.99), stabilised(np.r_[1.0, theta[nc:]])


def _denoised(u: np.ndarray, y: np.ndarray, order: int, nk: int) -> tuple[np.ndarray, np.ndarray]:
    """Whitening filter and output (N,) of a long ARX model driven by the input; ([1], y) where there is none."""
    try:
        whiten, gain = _long_arx(u, y, order, nk)
        denoised = lfilter(gain, stabilised(whiten, 0.9999), u, nk)
    except np.linalg.LinAlgError:
        return _ONE, y
    if not np.all(np.isfinite(whiten)) or not np.all(np.isfinite(denoised)):
        return _ONE, y
    return whiten, denoised


def first_models(s: Structure, u: np.ndarray, y: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Named starts (label, theta) with theta = [a, b, c, d, f]; a route that fails is left out."""
    order = s.na + s.nf
    routes: list[tuple[str, np.ndarray, np.ndarray]] = []
    size = y.size
    long = int(min(max(20, 4 * order), size // 10, 200))
    whiten = _ONE

    def attempt(label: str, make: Callable[[], tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray] | None:
        try:
            f, b = make()
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):
            return None
        if not (np.all(np.isfinite(f)) and np.all(np.isfinite(b))):
            return None
        routes.append((label, f, b))
        return f, b

    simple = attempt("least_squares", lambda: _arx(u, y, order, s.nb, s.nk))
    if order == 0 or s.name == "arx":
        pass
    else:
        whiten, denoised = _denoised(u, y, long, s.nk) if long > order + 2 else (_ONE, y)
        if simple is not None:
            f0 = simple[0]
            raw = attempt("steiglitz", lambda: _steiglitz(u, y, f0, s.nb, s.nk))
            if whiten.size > 1:
                uw, yw = lfilter(whiten, _ONE, u), lfilter(whiten, _ONE, y)
                seed = attempt("denoised", lambda: _steiglitz(uw, lfilter(whiten, _ONE, denoised), f0, s.nb, s.nk))
                seed = seed or raw or simple
                attempt("whitened", lambda: _steiglitz(uw, yw, seed[0], s.nb, s.nk))
            seed2 = raw or simple
            attempt("instrumental", lambda: _instrumental(u, y, seed2[0], seed2[1], whiten, s.nk))

    for label, f, b in reversed(routes):
        if s.na and not s.nf:
            v = lfilter(f, _ONE, y) - lfilter(b, _ONE, u, s.nk)
            a, f = f[1:], np.empty(0)
        else:
            f = stabilised(f)
            b = _numerator(u, y, f, s.nb, s.nk, whiten)
            v = y - lfilter(b, f, u, s.nk)
            a, f = np.zeros(s.na), f[1 : s.nf + 1]
        if not np.all(np.isfinite(v)):
            continue
        c, d = noise_model(v, s.nc, s.nd)
        yield label, np.r_[a, b, c[1:], d[1:], f]
