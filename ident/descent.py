"""Descent from first models: initial conditions by least squares, coefficients by Levenberg-Marquardt."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ident.options import InitialCondition, Options, SearchOptions
from ident.search import MARGIN, factor, residual, search
from ident.start import stabilised
from ident.structure import Structure

__all__ = ["Descent", "Descents", "Scaled", "best_state", "covariance_of", "radius"]


def _sizes(s: Structure, with_state: bool) -> np.ndarray:
    state = (s.n_plant_state, s.n_noise_state) if with_state else (0, 0)
    return np.array([s.na, s.nb, s.nc, s.nd, s.nf, *state])


def _buffers(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    pulse = np.zeros(size)
    pulse[0] = 1.0
    return np.zeros(size), np.zeros(size), np.zeros(size), np.zeros((8, size)), pulse


def _state_columns(s: Structure) -> slice:
    return slice(s.n_parameters, s.n_parameters + s.n_plant_state + s.n_noise_state)


def best_state(s: Structure, theta: np.ndarray, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Least-squares initial conditions at theta (linear): [I, K], loss without, loss with."""
    n = _sizes(s, True)
    full = np.r_[theta, np.zeros(n[5] + n[6])]
    w, v, e, signals, pulse = _buffers(y.size)
    before = residual(full, n, s.nk, u, y, w, v, e, radius(1.0))
    if not np.isfinite(before):
        return np.zeros(n[5] + n[6]), before, before
    r = factor(full, n, s.nk, u, y, w, v, e, signals, pulse)
    block = r[:, _state_columns(s)]
    scale = np.maximum(np.linalg.norm(block, axis=0), 1e-300)
    step = np.linalg.lstsq(block / scale, r[:, -1], rcond=1e-10)[0] / scale
    after = float(np.sum((r[:, -1] - block @ step) ** 2))
    return -step, float(before), after


def uses_state(s: Structure, kind: InitialCondition, before: float, after: float, size: int) -> bool:
    if kind is InitialCondition.ZERO:
        return False
    if kind is not InitialCondition.AUTO:
        return True
    from scipy.stats import f as f_distribution

    m = s.n_plant_state + s.n_noise_state
    free = size - s.n_parameters - m
    if m == 0 or free <= 0 or after <= 0.0:
        return False
    return bool((before - after) / m / (after / free) > f_distribution.ppf(0.999, m, free))


STAGES = (0.95, 0.98, 0.995)
"""Limits on the roots of C, released one after the other where the limit binds."""


def radius(noise: float) -> np.ndarray:
    """Largest root radius per polynomial for the search; only those of C and F are read."""
    radius = np.full(7, 1.0 - MARGIN)
    radius[2] = min(noise, 1.0 - MARGIN)
    return radius


def _descend(
    first: np.ndarray, n: np.ndarray, s: Structure, u: np.ndarray, y: np.ndarray, free: np.ndarray, how: SearchOptions
) -> tuple[np.ndarray, float, int, int, np.ndarray]:
    """One start to its minimum: theta, loss, iterations, code, factor.

    Levenberg-Marquardt in the coefficients themselves. Where that ends other than at a minimum inside the limits of stability,
    the start is followed again in coordinates that can slide along the limit, C held within the first of the ``STAGES``.
    """
    theta, loss, iterations, code, _, r = search(
        first, n, s.nk, u, y, free, how.max_iterations, how.tolerance, False, radius(how.noise_radius)
    )
    c = _c_columns(s)
    if code == 0 or not np.all(free[c]):
        return theta, loss, int(iterations), int(code), r
    total = int(iterations)
    x = first.copy()
    x[c] = stabilised(np.r_[1.0, x[c]], min(STAGES[0], how.noise_radius) - 0.01)[1:]
    for limit in [x for x in STAGES if x < how.noise_radius] + [how.noise_radius]:
        x, end, more, code_x, _, r_x = search(x, n, s.nk, u, y, free, 2 * how.max_iterations, how.tolerance, True, radius(limit))
        total += int(more)
        if end < loss:
            theta, loss, code, r = x, end, code_x, r_x
        if s.nc == 0 or np.max(np.abs(np.roots(np.r_[1.0, x[c]]))) < limit - 0.005:
            break
    return theta, loss, total, int(code), r


def _backcast(
    theta: np.ndarray, n: np.ndarray, s: Structure, u: np.ndarray, y: np.ndarray, free: np.ndarray, how: SearchOptions
) -> tuple[np.ndarray, float, int, int, np.ndarray]:
    """Alternate: initial conditions by least squares at the present coefficients, then the coefficients with these held.

    As ``_descend``. A step of one kind never raises the loss, so that the pair ends at a minimum of the joint problem.
    """
    count = s.n_parameters
    held = free.copy()
    held[count:] = 0
    total, previous = 0, np.inf
    theta, loss, iterations, code, r = _descend(theta, n, s, u, y, held, how)
    for _ in range(how.max_iterations):
        total += iterations
        if previous - loss <= how.tolerance * loss:
            break
        previous = loss
        state = best_state(s, theta[:count], u, y)[0]
        theta, loss, iterations, code, r = _descend(np.r_[theta[:count], state], n, s, u, y, held, how)
    return theta, loss, total, code, r


def _c_columns(s: Structure) -> slice:
    return slice(s.na + s.nb, s.na + s.nb + s.nc)


def _covariance(r: np.ndarray, n: int, variance: float) -> tuple[np.ndarray, bool]:
    """Parameter covariance from the factor of the gradient; the pseudo-inverse where the data leave directions open."""
    block = r[:-1, :-1]
    scale = np.linalg.norm(block, axis=0)
    scale[scale == 0.0] = 1.0
    _, values, vt = np.linalg.svd(block / scale)
    keep = values > 1e-9 * values[0]
    half = (vt[keep].T / values[keep]) / scale[:, None]
    return variance * (half @ half.T)[:n, :n], not bool(np.all(keep))


def _columns(r: np.ndarray, keep: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.qr(r[:, keep], mode="r"))


def covariance_of(r: np.ndarray, free: np.ndarray, states: int, variance: float) -> tuple[np.ndarray, bool]:
    """Covariance (p, p) of all coefficients, zero for those that were held, and whether the data leave directions open.

    r: factor of the gradient. free: 1 for each coefficient that was fitted. states: fitted initial conditions.
    """
    count = free.size
    keep = np.r_[free.astype(bool), np.ones(states, bool), True]
    covariance = np.zeros((count, count))
    inner, deficient = _covariance(_columns(r, keep), int(np.sum(free)), variance)
    index = np.flatnonzero(free)
    covariance[np.ix_(index, index)] = inner
    return covariance, deficient


@dataclass(frozen=True)
class Scaled:
    """Input and output (N,) in units of their standard deviations, and the largest root radii of the polynomials."""

    u: np.ndarray
    y: np.ndarray
    limit: np.ndarray

    def loss(self, s: Structure, theta: np.ndarray) -> float:
        """Sum of squared residuals at theta without initial conditions; inf where the model is unstable."""
        w, v, e, *_ = _buffers(self.y.size)
        return float(residual(theta, _sizes(s, False), s.nk, self.u, self.y, w, v, e, self.limit))

    def residuals(self, s: Structure, theta: np.ndarray, with_state: bool) -> np.ndarray:
        """Residuals (N,) at theta."""
        w, v, e, *_ = _buffers(self.y.size)
        residual(theta, _sizes(s, with_state), s.nk, self.u, self.y, w, v, e, self.limit)
        return e


@dataclass(frozen=True)
class Descent:
    """One start at its end: route, loss before and after, iterations, code of the search, theta, factor of the gradient."""

    route: str
    before: float
    loss: float
    iterations: int
    code: int
    theta: np.ndarray
    factor: np.ndarray
    with_state: bool


@dataclass
class Descents:
    """Descents from several starts on the same data; ``free`` (p,): 1 for each coefficient that is fitted."""

    structure: Structure
    scaled: Scaled
    options: Options
    free: np.ndarray
    ends: list[Descent] = field(default_factory=list)

    def follow(self, before: float, route: str, first: np.ndarray) -> None:
        """Descend from one start; the first one decides by an F test whether initial conditions are fitted."""
        s, u, y, kind = self.structure, self.scaled.u, self.scaled.y, self.options.initial_condition
        state, zero_loss, state_loss = best_state(s, first, u, y)
        with_state = self.ends[-1].with_state if self.ends else uses_state(s, kind, zero_loss, state_loss, y.size)
        theta, loss, iterations, code, r = self._descend(np.r_[first, state] if with_state else first, with_state)
        if kind is InitialCondition.AUTO and not with_state and not self.ends:
            state, zero_loss, state_loss = best_state(s, theta, u, y)
            if uses_state(s, kind, zero_loss, state_loss, y.size):
                with_state = True
                theta, loss, more, code, r = self._descend(np.r_[theta, state], True)
                iterations += more
        self.ends.append(Descent(route, before, float(loss), int(iterations), int(code), theta, r, with_state))

    def _descend(self, theta: np.ndarray, with_state: bool) -> tuple[np.ndarray, float, int, int, np.ndarray]:
        free = np.r_[self.free, np.ones(theta.size - self.free.size, np.int64)]
        descend = _backcast if self.options.initial_condition is InitialCondition.BACKCAST else _descend
        n = _sizes(self.structure, with_state)
        return descend(theta, n, self.structure, self.scaled.u, self.scaled.y, free, self.options.search)

    def agreed(self) -> bool:
        """Whether the two lowest losses agree to 1e-6."""
        losses = sorted(d.loss for d in self.ends)
        return len(losses) > 1 and losses[1] <= losses[0] * (1 + 1e-6) + 1e-24 * self.scaled.y.size

    def best(self) -> Descent:
        """The descent of the lowest loss."""
        return min(self.ends, key=lambda d: d.loss)
