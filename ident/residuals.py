"""Residual tests: is what the model leaves over white, and free of the input?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.data import frozen
from ident.estimate import Estimate
from ident.structure import Structure

__all__ = ["ResidualTests", "check_residuals", "residual_tests"]


def p_text(p: float) -> str:
    """A p value as text: ``p = 0.03``, or ``p < 1e-300`` where it underflows."""
    return f"p = {p:.2g}" if p > 1e-300 else "p < 1e-300"


@dataclass(frozen=True)
class ResidualTests:
    """Whiteness and independence of residuals, MATLAB ``resid`` (lag 25, 99 %) with a joint test added.

    auto: autocorrelation at lags 0 .. M, (M+1,). cross: correlation of e(t) with u(t - lag) at lags -M .. M, (2M+1,).
    auto_bound, cross_bound: the level's bound on a single lag. The joint tests: Ljung-Box over lags 1 .. M, and
    ``N r' Ru^-1 r / var(e)`` over lags 0 .. M (Ljung, section 16.6), chi-square. Lags before zero tell of feedback:
    ``feedback_p``.
    mean_p: p value of the residuals' mean being zero (Newey-West variance).
    """

    lags: int
    level: float
    auto: NDArray
    cross: NDArray
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


def _correlation(a: NDArray, b: NDArray, lags: int) -> NDArray:
    """1/N sum a(t) b(t - k), k = 0 .. lags."""
    n = a.size
    return np.array([a[k:] @ b[: n - k] for k in range(lags + 1)]) / n


def check_residuals(
    e: NDArray, u: NDArray, structure: Structure | None = None, lags: int = 25, level: float = 0.99
) -> ResidualTests:
    """Test residuals e against input u, both (N,).

    ``structure`` takes the fitted coefficients off the degrees of freedom: nc + nd (na too where A shapes the noise) off the
    whiteness test, nb + nf (+ na) off the independence test.
    """
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
    plant = 0 if s is None else s.nb + s.nf + s.na
    # coloured residuals widen the scatter of the cross-correlation: whiten both by the residuals' own short autoregression first
    ew, uw = _whitened(e0, u0, r, n)
    vw = float(np.mean(ew**2)) or 1e-300
    rw = _correlation(uw, uw, lags)
    column = np.r_[rw[0] * (1 + 1e-9), rw[1:]]
    independence = float(chi2.sf(_form(column, _correlation(ew, uw, lags), n, vw), max(1, lags + 1 - plant)))
    feedback = float(chi2.sf(_form(column[:-1], _correlation(uw, ew, lags)[1:], n, vw), max(1, lags)))
    long_run = variance * max(0.05, 1.0 + 2.0 * float(np.sum(r[1:] * (1 - np.arange(1, lags + 1) / (lags + 1)))))
    mean_p = float(2 * norm.sf(abs(mean) / np.sqrt(long_run / n)))
    return ResidualTests(
        lags, level, r, cross, quantile / np.sqrt(n), float(cross_bound), whiteness, independence, feedback, mean_p
    )


def _form(column: NDArray, c: NDArray, n: int, variance: float) -> float:
    """``n c' T^-1 c / variance`` with T the Toeplitz matrix of ``column``, directions without power left out."""
    from scipy.linalg import toeplitz

    values, vectors = np.linalg.eigh(toeplitz(column))
    keep = values > 1e-8 * values[-1]
    z = vectors[:, keep].T @ c
    return float(n * np.sum(z**2 / values[keep]) / variance)


def _whitened(e: NDArray, u: NDArray, r: NDArray, n: int) -> tuple[NDArray, NDArray]:
    """e and u through the autoregressive whitener of e."""
    from scipy.linalg import solve_toeplitz
    from scipy.signal import lfilter

    order = min(10, r.size - 1)
    if order < 1 or n * float(np.sum(r[1:] ** 2)) < 2.0 * r.size:
        return e, u
    a = solve_toeplitz(np.r_[1 + 1e-9, r[1:order]], r[1 : order + 1])
    whitener = np.r_[1.0, -a]
    return lfilter(whitener, 1.0, e), lfilter(whitener, 1.0, u)


def residual_tests(estimate: Estimate, lags: int = 25, level: float = 0.99) -> ResidualTests:
    """Tests on an estimate's own residuals."""
    return check_residuals(np.asarray(estimate.residuals), np.asarray(estimate.data.u), estimate.model.structure, lags, level)
