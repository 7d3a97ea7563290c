"""Levenberg-Marquardt on simulated residuals, with bounds, wide secants and a status that says why it stopped."""

from __future__ import annotations

import enum
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from diagnose.problem.problem import Residual

__all__ = [
    "Fit",
    "Linearised",
    "Run",
    "Status",
    "jacobian",
    "levenberg_marquardt",
    "orthonormal",
    "residual_and_jacobian",
]


class Status(enum.Enum):
    """Why a fit stopped; the value is the advice."""

    CONVERGED = "the gain of a further step is below the tolerance"
    BUDGET = "stopped at the iteration budget: may improve with a larger one"
    STALLED = "no step improves the cost, yet the gradient is not small: the cost is rough here"
    FAILED = "the model could not be run at the start values"


class Linearised:
    """A residual (N,) and its Jacobian J (N, p): known, or computed when first asked for.

    ``mark``: what they follow from, for who remembers fits; empty where nobody does.
    """

    def __init__(self, compute: Callable[[], tuple[np.ndarray, np.ndarray]], mark: str = "") -> None:
        self._compute, self.mark = compute, mark
        self._arrays: tuple[np.ndarray, np.ndarray] | None = None
        self._computing = threading.RLock()  # one of its own: that of a cached property is held for all others meanwhile

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Residual and J."""
        with self._computing:
            if self._arrays is None:
                self._arrays = self._compute()
            return self._arrays

    def marked(self, mark: str) -> Linearised:
        """The same under a mark."""
        return Linearised(lambda: self.arrays, mark)

    @classmethod
    def known(cls, residual: np.ndarray, J: np.ndarray) -> Linearised:
        """Of arrays that are there."""
        return cls(lambda: (residual, J))


@dataclass(frozen=True, eq=False)
class Fit:
    """Outcome: x (p,), cost = sum of squares, residual (N,) and J (N, p) at the last linearisation, status, gradient measure.

    J is zero where none could be had: a neighbour of the start could not be run.
    """

    x: np.ndarray
    cost: float
    linear: Linearised
    status: Status
    iterations: int
    predicted_gain: float

    @property
    def residual(self) -> np.ndarray:
        """Residual (N,) at x."""
        return self.linear.arrays[0]

    @property
    def J(self) -> np.ndarray:
        """Jacobian (N, p) at the last linearisation."""
        return self.linear.arrays[1]


Task = Callable[[], np.ndarray | None]
Run = Callable[[Sequence[Task]], list[np.ndarray | None]]


def jacobian(
    residual: Residual, x: np.ndarray, r0: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray, run: Run,
    which: Sequence[int] | None = None,
) -> np.ndarray | None:  # fmt: skip
    """Forward secants (N, p), or of the numbers ``which`` (k,) alone (N, k); turned inward at a bound.

    One that cannot be run is turned too; None when that fails as well.
    """
    points, steps = _secant_points(x, step, lower, upper, which)
    return _secants(r0, *_turned(residual, x, run([partial(residual, y) for y in points]), points, steps, run))


def residual_and_jacobian(
    residual: Residual, x: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray, run: Run,
    which: Sequence[int] | None = None,
) -> tuple[np.ndarray | None, np.ndarray | None]:  # fmt: skip
    """Residual (N,) at x and `jacobian` there, all run side by side; None for what could not be run."""
    points, steps = _secant_points(x, step, lower, upper, which)
    r, *columns = run([partial(residual, y) for y in (x, *points)])
    return r, None if r is None else _secants(r, *_turned(residual, x, columns, points, steps, run))


def _turned(
    residual: Residual, x: np.ndarray, columns: list[np.ndarray | None], points: list[np.ndarray], steps: list[float], run: Run
) -> tuple[list[np.ndarray | None], list[float]]:
    """Columns, of which those that could not be run are run on the other side of x, and their steps."""
    failed = [k for k, c in enumerate(columns) if c is None]
    if not failed or len(failed) == len(columns) > 1:
        return columns, steps
    other = run([partial(residual, 2 * x - points[k]) for k in failed])
    columns, steps = list(columns), list(steps)
    for k, c in zip(failed, other, strict=True):
        columns[k], steps[k] = c, -steps[k]
    return columns, steps


def _secant_points(
    x: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray, which: Sequence[int] | None
) -> tuple[list[np.ndarray], list[float]]:
    """Points a step away from x in one number each, and these steps."""
    points, steps = [], []
    for i in range(len(x)) if which is None else which:
        h = -step[i] if x[i] + step[i] > upper[i] or x[i] + step[i] < lower[i] else step[i]
        points.append(x.copy())
        points[-1][i] += h
        steps.append(h)
    return points, steps


def _secants(r0: np.ndarray, columns: Sequence[np.ndarray | None], steps: Sequence[float]) -> np.ndarray | None:
    J = np.empty((len(r0), len(columns)), order="F")  # whose columns are written, and multiplied, in one piece
    for i, c in enumerate(columns):
        if c is None:
            return None
        np.subtract(c, r0, out=J[:, i])
    J /= np.array(steps)
    return J


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns (N, p) that span others (N, p), of whatever sizes those are."""
    return np.asarray(np.linalg.qr(columns / (np.linalg.norm(columns, axis=0) + 1e-300))[0])


def _bounded_step(A: np.ndarray, g: np.ndarray, x: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Minimiser of g d + d A d / 2 within the bounds: coordinates at a bound are held while the slope points outward."""
    n = len(x)
    d = np.zeros(n)
    free = np.ones(n, bool)
    for _ in range(3 * n):
        if free.any():
            rhs = -(g[free] + A[np.ix_(free, ~free)] @ d[~free])
            d[free] = np.linalg.lstsq(A[np.ix_(free, free)], rhs, rcond=1e-14)[0]
        out = free & ((x + d < lower) | (x + d > upper))
        if out.any():
            d[out] = np.clip(x[out] + d[out], lower[out], upper[out]) - x[out]
            free &= ~out
            continue
        slope = A @ d + g
        inward = ~free & (((d <= lower - x) & (slope < 0)) | ((d >= upper - x) & (slope > 0)))
        if not inward.any():
            break
        free[np.argmax(np.where(inward, np.abs(slope), 0.0))] = True
    step: np.ndarray = np.clip(x + d, lower, upper) - x
    return step


def _moved(
    A: np.ndarray, scale: np.ndarray, g: np.ndarray, x: np.ndarray, lower: np.ndarray, upper: np.ndarray,
    reach: np.ndarray | None, mu: float,
) -> np.ndarray:  # fmt: skip
    """Where the step damped by ``mu`` leads."""
    d = _bounded_step(A + mu * np.diag(scale), g, x, lower, upper)
    if reach is not None:
        d = d * min(1.0, float(np.min(reach / np.maximum(np.abs(d), 1e-300))))
    return np.asarray(np.clip(x + d, lower, upper))


@dataclass
class _Point:
    """Where a fit is: x (p,), residual r (N,), cost, Jacobian J (N, p), damping mu; the last step d, residual and gains."""

    x: np.ndarray
    r: np.ndarray
    cost: float
    J: np.ndarray
    mu: float
    r_old: np.ndarray
    d: np.ndarray
    gain: float = np.inf
    actual: float = 0.0


@dataclass(frozen=True, eq=False)
class _Method:
    """How a fit goes on from a point; see `levenberg_marquardt`."""

    residual: Residual
    slope: Callable[[np.ndarray], Residual] | None
    lower: np.ndarray
    upper: np.ndarray
    step: np.ndarray
    run: Run
    secant: bool
    fresh: Sequence[int]
    reach: np.ndarray | None

    def there(self, x: np.ndarray) -> Residual:
        """The residual whose secants at x are the Jacobian."""
        return self.residual if self.slope is None else self.slope(x)

    def linearise(self, now: _Point, given: np.ndarray | None, *, first: bool) -> bool:
        """Bring the Jacobian up to date; whether it could be had."""
        if self.secant and not first and self.slope is None:
            return self._by_secant(now)
        J = given
        if J is None:
            J = jacobian(self.there(now.x), now.x, now.r, self.step, self.lower, self.upper, self.run)
        if J is None:
            return False
        now.J = J
        return True

    def _by_secant(self, now: _Point) -> bool:
        """Broyden's rank-one update, but for the columns that are differenced anew."""
        part = None
        if len(self.fresh):
            part = jacobian(self.there(now.x), now.x, now.r, self.step, self.lower, self.upper, self.run, self.fresh)
            if part is None:
                return False
        missed, along = now.r - now.r_old - now.J @ now.d, now.d / (now.d @ now.d)
        for i in np.flatnonzero(along):
            now.J[:, i] += missed * along[i]
        if part is not None:
            now.J[:, self.fresh] = part
        return True

    def descend(self, now: _Point, tolerance: float) -> Status | None:
        """One step to a lower cost, damped as far as it takes; the status with which the fit ends, None where it goes on."""
        A, g = now.J.T @ now.J, now.J.T @ now.r
        scale = np.maximum(np.diag(A), 1e-12 * np.max(np.diag(A)) + 1e-300)
        moved = partial(_moved, A, scale, g, now.x, self.lower, self.upper, self.reach)
        first_gain: float | None = None
        for _ in range(12):
            trial = moved(now.mu)
            now.d = d = trial - now.x
            now.gain = -float(2 * g @ d + d @ A @ d) / now.cost
            first_gain = now.gain if first_gain is None else first_gain
            if abs(now.gain) < tolerance * 0.1 and now.mu <= 1e-2:
                return Status.CONVERGED
            if now.gain <= 0:
                now.mu = max(now.mu, 1e-6) * 10
                continue
            if _accepted(now, trial, self.residual(trial)):
                return Status.CONVERGED if now.actual < tolerance or now.cost == 0.0 else None
            now.mu = max(now.mu, 1e-6) * 10
        return Status.CONVERGED if first_gain is not None and first_gain < 10 * tolerance else Status.STALLED


def _accepted(now: _Point, trial: np.ndarray, r: np.ndarray | None) -> bool:
    """Whether a trial step lowers the cost; then it is taken."""
    if r is None or not (cost := float(r @ r)) < now.cost:
        return False
    now.actual = (now.cost - cost) / now.cost
    now.r_old = now.r
    now.x, now.r, now.cost = trial, r, cost
    now.mu = max(now.mu * (0.1 if now.actual > 0.5 * now.gain else 1.0), 1e-9)
    return True


def levenberg_marquardt(
    residual: Residual,
    x0: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    *,
    step: np.ndarray,
    run: Run,
    max_iterations: int = 20,
    tolerance: float = 1e-5,
    J0: np.ndarray | None = None,
    r0: np.ndarray | None = None,
    secant: bool = False,
    fresh: Sequence[int] = (),
    reach: np.ndarray | None = None,
    coarse: tuple[float, float] = (np.inf, 0.0),
    slope: Callable[[np.ndarray], Residual] | None = None,
    spent: Callable[[], bool] = lambda: False,
) -> Fit:
    """Minimise |r(x)|^2 within bounds.

    tolerance: relative gain of the cost below which it has converged; J0: a Jacobian for the first iteration, which is written
    to, r0: the residual at x0, when known;
    secant: from the second iteration on the Jacobian is brought up to date by Broyden's rank-one formula (C. G. Broyden,
    Math. Comp. 19 (1965) 577) and not differenced anew: cheap, for a fit that is only compared with others;
    fresh: with ``secant``, the columns that are differenced all the same, since they change most;
    reach (p,): largest change of each number in one iteration, by which the whole step is shortened;
    coarse: a cost, and the tolerance that is enough above it;
    slope: of a point, the residual whose secants there are the Jacobian, where those of the residual itself tell little;
    spent: asked after each iteration whether it has taken all the simulations that it may.
    """
    lower, upper = bounds
    x = np.clip(x0, lower, upper)
    r = r0
    if r is None and J0 is None and slope is None:
        r, J0 = residual_and_jacobian(residual, x, step, lower, upper, run)
    elif r is None:
        r = residual(x)
    if r is None:
        return Fit(x, np.inf, Linearised.known(np.empty(0), np.empty((0, len(x)))), Status.FAILED, 0, 0.0)
    J = np.zeros((len(r), len(x)))  # what a fit keeps whose first Jacobian fails
    now = _Point(x, r, float(r @ r), J, 1e-3, r, np.zeros(len(x)))  # little damping: near a Gauss-Newton step
    if now.cost == 0.0:
        return Fit(x, 0.0, Linearised.known(r, J), Status.CONVERGED, 0, 0.0)
    method = _Method(residual, slope, lower, upper, step, run, secant, fresh, reach)
    status, iteration = Status.BUDGET, 0
    for iteration in range(1, max_iterations + 1):
        first = iteration == 1
        if not method.linearise(now, J0 if first else None, first=first):
            status = Status.STALLED
            break
        enough = max(tolerance, coarse[1]) if now.cost > coarse[0] else tolerance
        ended = method.descend(now, enough)
        if ended is not None:
            status = ended
            break
        if spent():
            break
    return Fit(now.x, now.cost, Linearised.known(now.r, now.J), status, iteration, float(now.gain))
