"""Figures of merit: fit, FPE, AIC, BIC, with MATLAB's formulas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ident.data import IOData
from ident.estimate import Estimate
from ident.predict import simulated
from mjsim.errors import InputError

__all__ = ["Quality", "fit_percent", "input_effect_p", "nrmse", "quality"]

EFFECT_LAGS = 30
"""Lags of either channel in the regression by which the input's effect is tested."""


def nrmse(measured: ArrayLike, modelled: ArrayLike) -> float:
    """``norm(y - yhat) / norm(y - mean(y))``: 0 is perfect, 1 is no better than the mean."""
    y, p = np.asarray(measured, float), np.asarray(modelled, float)
    spread = float(np.linalg.norm(y - y.mean()))
    if spread == 0.0:
        raise InputError("output", "it is constant", "a signal that moves")
    return float(np.linalg.norm(y - p)) / spread


def fit_percent(measured: ArrayLike, modelled: ArrayLike) -> float:
    """``100 (1 - NRMSE)`` [%], MATLAB ``compare`` and ``goodnessOfFit``; negative when the mean would do better."""
    return 100.0 * (1.0 - nrmse(measured, modelled))


@dataclass(frozen=True)
class Quality:
    """How good an estimate is on its own data.

    With V = mean(e^2), N samples, d coefficients: ``FPE = V (1 + d/N) / (1 - d/N)``, ``AIC = N ln V + 2 d + N (ln 2 pi + 1)``,
    ``BIC = N ln V + d ln N + N (ln 2 pi + 1)``, normalised ``nAIC = ln V + 2 d / N`` (MATLAB ``sys.Report.Fit``).
    fit_percent: of the one-step prediction (MATLAB's FitPercent for prediction focus). simulation_percent: of the simulated
    output.
    """

    fit_percent: float
    simulation_percent: float
    loss: float
    fpe: float
    aic: float
    bic: float
    naic: float


def information(loss: float, n: int, d: int) -> tuple[float, float, float, float]:
    """(FPE, AIC, BIC, nAIC) of a loss with n samples and d coefficients."""
    log = np.log(max(loss, 1e-300))
    constant = n * (np.log(2 * np.pi) + 1)
    fpe = loss * (1 + d / n) / max(1e-300, 1 - d / n)
    return fpe, n * log + 2 * d + constant, n * log + d * np.log(n) + constant, log + 2 * d / n


def quality(estimate: Estimate) -> Quality:
    """Figures of merit of an estimate."""
    y = estimate.data.y
    fpe, aic, bic, naic = information(estimate.loss, len(estimate.data), estimate.n_free)
    simulation = simulated(estimate.model, estimate.data)
    sim = fit_percent(y, simulation) if np.all(np.isfinite(simulation)) else float("-inf")
    return Quality(fit_percent(y, y - estimate.residuals), sim, estimate.loss, float(fpe), float(aic), float(bic), float(naic))


def input_effect_p(data: IOData) -> float:
    """p value of "the input does nothing to the output": F test of the lags of u (from 0 on) in a high-order ARX model.

    The lags of y take up noise of any colour, so the test holds its size where the residual tests have nothing to test
    (Granger, Econometrica 37, 1969). Directions in which u has no power do not count.
    """
    from scipy.stats import f as f_distribution

    from ident.kernel import factor_lags

    n = len(data)
    lags = min(EFFECT_LAGS, n // 20)
    y, u = np.asarray(data.y) - np.mean(data.y), np.asarray(data.u) - np.mean(data.u)
    y, u = y / (np.std(y) or 1.0), u / (np.std(u) or 1.0)
    r = factor_lags(np.stack([y, u]), np.ones(2), np.array([1, 0]), np.array([lags, lags + 1]), y, lags)
    block, target = r[lags:-1, lags:-1], r[lags:-1, -1]
    left, values, _ = np.linalg.svd(block)
    keep = values > 1e-6 * values[0]
    rank = int(keep.sum())
    explained = float(np.sum((left[:, keep].T @ target) ** 2))
    rest = float(target @ target) - explained + float(r[-1, -1] ** 2)
    free = n - 2 * lags - rank
    return float(f_distribution.sf(explained / rank / max(rest / free, 1e-300), rank, free)) if free > 0 else 0.0
