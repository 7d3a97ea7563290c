"""Residual tests: is what the model leaves over white, and free of the input?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.data import frozen
from ident.estimate import Estimate
from ident.structure import Structure

__all__ = ["ResidualTests", "check_residuals", "residual_tests"]

Gradient = tuple[tuple[np.ndarray, int, int], ...]
"""(signal (N,), first lag, number of lags): the columns of de/dtheta for a part of theta, but for their sign."""
OPEN_DIRECTION = 1e-4
"""Size, relative to the input's, above which a direction of its lags that the gradient leaves over is tested."""


def p_text(p: float) -> str:
    """A p value as text: ``p = 0.03``, or ``p < 1e-300`` where it underflows."""
    return f"p = {p:.2g}" if p > 1e-300 else "p < 1e-300"


@dataclass(frozen=True)
class ResidualTests:
    """Whiteness and independence of residuals, MATLAB ``resid`` (lag 25, 99 %) with a joint test added.

    auto: autocorrelation at lags 0 .. M, (M+1,). cross: correlation of e(t) with u(t - lag) at lags -M .. M, (2M+1,).
    auto_bound, cross_bound: the level's bound on a single lag. The joint tests: Ljung-Box over lags 1 .. M, and of the inputs at
    lags 0 .. M (see `check_residuals`), chi-square. Lags before zero tell of feedback: ``feedback_p``.
    mean_p: p value of the residuals' mean being zero (Newey-West variance).
    """

    lags: int
    level: float
    auto: np.ndarray
    cross: np.ndarray
    auto_bound: float
    cross_bound: float
    whiteness_p: float
    independence_p: float
    feedback_p: float
    mean_p: float

    def __post_init__(self) -> None:
        for name in ("auto", "cross"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def white(self) -> bool:
        """Whether the residuals pass the whiteness test at the level."""
        return self.whiteness_p >= 1 - self.level

    @property
    def independent(self) -> bool:
        """Whether the residuals pass the test of independence of past inputs at the level."""
        return self.independence_p >= 1 - self.level

    @property
    def feedback(self) -> bool:
        """Whether residuals correlate with later inputs: a sign of feedback in the data."""
        return self.feedback_p < 1 - self.level

    @property
    def auto_outside(self) -> int:
        """Number of lags 1 .. M whose autocorrelation lies outside the bound."""
        return int(np.sum(np.abs(self.auto[1:]) > self.auto_bound))

    @property
    def cross_outside(self) -> int:
        """Number of lags 0 .. M whose cross-correlation lies outside the bound."""
        return int(np.sum(np.abs(self.cross[self.lags :]) > self.cross_bound))


def _correlation(a: np.ndarray, b: np.ndarray, lags: int) -> np.ndarray:
    """1/N sum a(t) b(t - k), k = 0 .. lags."""
    n = a.size
    return np.array([a[k:] @ b[: n - k] for k in range(lags + 1)]) / n


def check_residuals(
    e: np.ndarray,
    u: np.ndarray,
    structure: Structure | None = None,
    lags: int = 25,
    level: float = 0.99,
    gradient: Gradient | None = None,
) -> ResidualTests:
    """Test residuals e against input u, both (N,).

    Whiteness: Ljung-Box; ``structure`` takes the coefficients that shape the noise off its degrees of freedom (nc + nd, na too
    where there is no F). Independence: coloured residuals and the inputs are whitened alike by the residuals' own short
    autoregression; then ``c' T^-1 c`` over lags 0 .. M is chi-square (Ljung, section 16.6) for residuals of a model fitted to
    other data. For its own data (``gradient``: what the plant's coefficients do to e) the inputs' lags are first freed of the
    gradient, for the fit has emptied e of it: a Lagrange multiplier test (Engle, Handbook of Econometrics II, 1984, chapter 13).
    Taking the number of coefficients off the degrees of freedom instead, as is usual, holds only when the plant's memory is short
    against M: on slow or lightly damped plants it rejects good models three times too often.
    """
    from scipy.signal import lfilter
    from scipy.stats import chi2, norm

    n = e.size
    lags = int(min(lags, n // 4))
    mean = float(e.mean())
    e0, u0 = e - mean, u - u.mean()
    auto = _correlation(e0, e0, lags)
    variance = auto[0] if auto[0] > 0.0 else 1e-300
    r = auto / variance
    ru = _correlation(u0, u0, lags)
    quantile = float(norm.ppf(0.5 + level / 2))
    forward = _correlation(e0, u0, lags)  # e(t) u(t-k)
    backward = _correlation(u0, e0, lags)  # e(t) u(t+k)
    scale = np.sqrt(variance * max(ru[0], 1e-300))
    cross = np.r_[backward[:0:-1], forward] / scale
    spread = 1.0 + 2.0 * float(np.sum(r[1:] * ru[1:] / max(ru[0], 1e-300) * (1 - np.arange(1, lags + 1) / (lags + 1))))
    cross_bound = quantile * np.sqrt(max(spread, 0.05) / n)

    s = structure
    used = 0 if s is None else (s.nc + s.nd + (s.na if s.nf == 0 else 0))
    ljung_box = n * (n + 2) * float(np.sum(r[1:] ** 2 / (n - np.arange(1, lags + 1))))
    whiteness = float(chi2.sf(ljung_box, max(1, lags - used)))
    # coloured residuals widen the scatter of the cross-correlation: whiten both by the residuals' own short autoregression first
    whitener = _whitener(r, n)
    ew, uw = (lfilter(whitener, 1.0, x) for x in (e0, u0))
    vw = float(np.mean(ew**2)) or 1e-300
    rw = _correlation(uw, uw, lags)
    column = np.r_[rw[0] * (1 + 1e-9), rw[1:]]
    if gradient is None:
        independence = float(chi2.sf(_form(column, _correlation(ew, uw, lags), n, vw), lags + 1))
    else:
        statistic, free = _multiplier(ew, uw, gradient, whitener, lags)
        independence = float(chi2.sf(statistic, free)) if free else 1.0
    feedback = float(chi2.sf(_form(column[:-1], _correlation(uw, ew, lags)[1:], n, vw), max(1, lags)))
    long_run = variance * max(0.05, 1.0 + 2.0 * float(np.sum(r[1:] * (1 - np.arange(1, lags + 1) / (lags + 1)))))
    mean_p = float(2 * norm.sf(abs(mean) / np.sqrt(long_run / n)))
    return ResidualTests(
        lags, level, r, cross, quantile / np.sqrt(n), float(cross_bound), whiteness, independence, feedback, mean_p
    )


def _form(column: np.ndarray, c: np.ndarray, n: int, variance: float) -> float:
    """``n c' T^-1 c / variance`` with T the Toeplitz matrix of ``column``, directions without power left out."""
    from scipy.linalg import toeplitz

    values, vectors = np.linalg.eigh(toeplitz(column))
    keep = values > 1e-8 * values[-1]
    z = vectors[:, keep].T @ c
    return float(n * np.sum(z**2 / values[keep]) / variance)


def _whitener(r: np.ndarray, n: int) -> np.ndarray:
    """Autoregressive polynomial that whitens a signal of autocorrelation r over n samples; 1 when it is white already."""
    from scipy.linalg import solve_toeplitz

    order = min(10, r.size - 1)
    if order < 1 or n * float(np.sum(r[1:] ** 2)) < 2.0 * r.size:
        return np.ones(1)
    whitener: np.ndarray = np.r_[1.0, -solve_toeplitz(np.r_[1 + 1e-9, r[1:order]], r[1 : order + 1])]
    return whitener


def _multiplier(e: np.ndarray, u: np.ndarray, gradient: Gradient, whitener: np.ndarray, lags: int) -> tuple[float, int]:
    """Lagrange multiplier statistic of the lags 0 .. ``lags`` of u in e, freed of the gradient, and its degrees of freedom."""
    from scipy.signal import lfilter

    from ident.kernel import factor_lags

    signals = [lfilter(whitener, 1.0, x) for x, _, _ in gradient]
    scales = [float(np.std(x)) or 1.0 for x in (*signals, u)]
    table = np.stack([x / scale for x, scale in zip((*signals, u), scales, strict=True)])
    counts = np.array([count for _, _, count in gradient] + [lags + 1])
    first = np.array([lag for _, lag, _ in gradient] + [0])
    r = factor_lags(table, np.ones(counts.size), first, counts, e, 0)
    fitted = int(counts[:-1].sum())
    block, target = r[fitted:-1, fitted:-1], r[fitted:-1, -1]
    left, values, _ = np.linalg.svd(block)
    keep = values > OPEN_DIRECTION * np.sqrt(e.size)
    explained = float(np.sum((left[:, keep].T @ target) ** 2))
    rest = float(target @ target) - explained + float(r[-1, -1] ** 2)
    free = max(1, e.size - fitted - int(keep.sum()))
    return explained / max(rest / free, 1e-300), int(keep.sum())


def _gradient(estimate: Estimate) -> Gradient:
    """Signals whose lags are the derivatives of e with respect to A, B, F and the plant's initial state (see `ident.search`)."""
    from scipy.signal import lfilter

    m, d = estimate.model, estimate.data
    s = m.structure
    u, y = np.asarray(d.u), np.asarray(d.y)
    by_u = lfilter(m.D, m.C, u)
    out = [(lfilter(m.D, m.C, y), 1, s.na), (lfilter([1.0], m.F, by_u), s.nk, s.nb)]
    if s.nf:
        pulse = np.zeros(u.size)
        pulse[0] = 1.0
        moved = lfilter(np.r_[np.zeros(s.nk), m.B], m.F, u)
        state = estimate.initial_plant
        if state.size:
            moved = moved + lfilter(state, m.F, pulse)
            out.append((lfilter([1.0], m.F, lfilter(m.D, m.C, pulse)), 0, state.size))
        out.append((lfilter([1.0], m.F, lfilter(m.D, m.C, moved)), 1, s.nf))
    return tuple(g for g in out if g[2])


def residual_tests(estimate: Estimate, lags: int = 25, level: float = 0.99) -> ResidualTests:
    """Tests on an estimate's own residuals."""
    e, u = np.asarray(estimate.residuals), np.asarray(estimate.data.u)
    return check_residuals(e, u, estimate.model.structure, lags, level, _gradient(estimate))
