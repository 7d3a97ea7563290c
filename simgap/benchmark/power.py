"""Power: how the chance to see an effect grows with its size over the noise, by logistic regression on the log of the size.

    P(seen) = 1 / (1 + exp(-(a + b log10 size)))

The likelihood is penalised by half the log-determinant of the information (Firth 1993, Biometrika 80, 27-38), so that
the fit exists where a size parts the seen from the unseen without overlap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["PowerCurve", "power_curve"]

FEWEST = 8  # cases
OF_EACH = 2  # seen and unseen


@dataclass(frozen=True)
class PowerCurve:
    """Cases by size, and the fitted curve where there are enough.

    ``at50``, ``at90``: sizes [noise rms] seen with that chance, with the 95 % interval of ``at50``; nan without a fit, and
    ``note`` says why.
    """

    sizes: tuple[float, ...]
    seen: tuple[bool, ...]
    intercept: float
    slope: float
    at50: float
    at90: float
    at50_ci95: tuple[float, float]
    note: str

    def chance(self, size: np.ndarray) -> np.ndarray:
        """The fitted chance at sizes [noise rms]."""
        return 1 / (1 + np.exp(-(self.intercept + self.slope * np.log10(size))))


def _fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """(a, b) and their covariance by Firth's modified scores; None when it does not settle."""
    X = np.stack([np.ones_like(x), x], axis=1)
    beta = np.zeros(2)
    for _ in range(200):
        p = 1 / (1 + np.exp(-np.clip(X @ beta, -30, 30)))
        w = p * (1 - p)
        information = X.T @ (w[:, None] * X)
        try:
            covariance = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return None
        leverage = w * np.einsum("ij,jk,ik->i", X, covariance, X)
        step = covariance @ (X.T @ (y - p + leverage * (0.5 - p)))
        step *= min(1.0, 2.0 / max(float(np.max(np.abs(step))), 1e-300))
        beta = beta + step
        if float(np.max(np.abs(step))) < 1e-8:
            return beta, covariance
    return None


def power_curve(sizes: Sequence[float], seen: Sequence[bool]) -> PowerCurve:
    """Fit the chance to be seen over the size [noise rms]."""
    order = sorted(range(len(sizes)), key=lambda i: sizes[i])
    s, k = tuple(float(sizes[i]) for i in order), tuple(bool(seen[i]) for i in order)
    blank = (math.nan, math.nan)
    hits = sum(k)

    def without(note: str) -> PowerCurve:
        return PowerCurve(s, k, math.nan, math.nan, math.nan, math.nan, blank, note)

    if not s:
        return without("no cases")
    if min(hits, len(s) - hits) < OF_EACH or len(s) < FEWEST:
        if hits == len(s):
            return without(f"all {len(s)} seen, the smallest at {s[0]:.2g}")
        if hits == 0:
            return without(f"none of {len(s)} seen, the largest at {s[-1]:.2g}")
        return without(f"{hits} of {len(s)} seen: too few for a curve")
    fitted = _fit(np.log10(s), np.array(k, float))
    if fitted is None or fitted[0][1] <= 0:
        return without(f"{hits} of {len(s)} seen: the chance does not grow with the size")
    (a, b), covariance = fitted
    x50 = -a / b
    gradient = np.array([-1 / b, a / b**2])
    spread = 1.96 * math.sqrt(float(gradient @ covariance @ gradient))
    low, high = (10.0 ** float(np.clip(x50 + d, -6, 6)) for d in (-spread, spread))
    at90 = 10.0 ** float(np.clip(x50 + math.log(9) / b, -6, 6))
    return PowerCurve(s, k, float(a), float(b), 10.0 ** float(np.clip(x50, -6, 6)), at90, (low, high), "")
