"""Whether one structure is significantly better than another on held-out data: paired blocks of error, by two tests."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from diagnose.fit.fitted import HeldOut
from diagnose.thresholds import FINER

__all__ = ["Comparison", "compare"]


@dataclass(frozen=True)
class Comparison:
    """A richer structure against a poorer one on held-out data: gain of squared error, relative, and its one-sided p-value."""

    relative_gain: float
    p_value: float


def signed_rank(d: np.ndarray) -> float:
    """One-sided p-value of Wilcoxon's signed-rank test that differences (N,) lie above zero.

    By the normal approximation, corrected for ties and without zeros (`scipy.stats.wilcoxon`, method "approx")."""
    from scipy.special import ndtr

    d = d[d != 0]
    n = len(d)
    _, which, alike = np.unique(np.abs(d), return_inverse=True, return_counts=True)
    rank = np.cumsum(alike) - 0.5 * (alike - 1)
    above = float(np.sum(rank[which][d > 0])) - n * (n + 1) / 4
    variance = n * (n + 1) * (2 * n + 1) / 24 - float(np.sum(alike**3 - alike)) / 48
    return float(ndtr(-above / math.sqrt(variance)))


def compare(before: HeldOut | None, after: HeldOut | None, *, known: bool = False) -> Comparison:
    """Paired blocks of held-out error, by two tests; the smaller p-value, doubled for there being two.

    Wilcoxon's signed-rank test on the differences of squared errors, robust against a few outliers, but which is blind to
    an effect that shows in few of them. And the score d'(e0 + e1) / 2 of the difference d = e0 - e1 of two predictions, by
    Student's t: what it would be by chance is taken from the errors of the better model, block by block, and is at least
    that of white noise of the weight's variance where the noise is ``known``; its degrees of freedom are the number of
    blocks that d makes itself felt in (F. E. Satterthwaite, Biometrics 2 (1946) 110).
    """
    from scipy.special import stdtr

    if after is None:
        return Comparison(-math.inf, 1.0)
    if before is None:  # the poorer model cannot be run there at all
        return Comparison(math.inf, 0.0)
    d = before.sse - after.sse
    d = d[before.n > 0]
    gain = float(np.sum(d) / max(before.chi2, 1e-300))
    if len(d) < 3 or np.std(d) == 0:
        return Comparison(gain, 1.0)
    ranked = signed_rank(d)
    shift = before.errors - after.errors
    ends = np.cumsum(before.n)
    edges = np.unique(
        np.concatenate([np.linspace(b - n, b, FINER + 1)[:-1] for b, n in zip(ends, before.n, strict=True)]).astype(int)
    )
    edges = edges[edges < len(shift)]
    energy = np.add.reduceat(shift**2, edges)
    by_chance = float(np.sum(np.add.reduceat(shift * after.errors, edges) ** 2))
    if known:
        by_chance = max(by_chance, float(np.sum(energy)))
    freedom = max(1.0, float(np.sum(energy)) ** 2 / float(np.sum(energy**2)) - 1.0)
    score = float(stdtr(freedom, -0.5 * np.sum(d) / math.sqrt(by_chance + 1e-300)))
    return Comparison(gain, min(1.0, 2.0 * min(ranked, score)))
