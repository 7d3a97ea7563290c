"""Stepwise BIC with raw N: forward selection over the whole library, by the diagnosis's own fitter, nothing to keep it quiet.

    BIC = N log(chi2 / N) + k log N        N: every sample of the estimation recording, counted as independent

The effect that lowers BIC most enters, until none does. No held-out check, no whitening, no elimination. Rivals are screened and
raced as in the diagnosis (those that a linearised fit promises least are not fitted), so its false alarms are a lower bound.
"""

from __future__ import annotations

import math

from diagnose.fit.fitted import Fitted
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import candidates
from diagnose.structure.search import Search
from lab.benchmark.arms.base import Answer, Arm, Task
from lab.benchmark.arms.nominal import fitting, orders, refitted

__all__ = ["ARM", "DEPTH", "bic", "fit"]

DEPTH = 3  # most effects, as in the diagnosis


def bic(fitted: Fitted) -> float:
    """BIC of a fitted structure, every sample counted."""
    n = fitted.n
    return n * math.log(max(fitted.chi2, 1e-300) / n) + len(fitted.hypothesis.entries) * math.log(n)


def fit(task: Task) -> Answer:
    """Add effects while BIC falls."""
    with fitting(task) as fitter:
        base = refitted(fitter)
        # entry 0: any gain in the score test is enough to be fitted
        search = Search(fitter, SearchOptions(entry=0.0, depth=DEPTH))
        search.keep(base.fitted)
        current = base.fitted
        while len(current.effects) < DEPTH:
            search.use(search.fitter.with_orders(orders(fitter, current)))
            search.state.consider(candidates(search.fitter))
            search.expand(current)
            richer = [f for f in search.fits.values() if len(f.effects) == len(current.effects) + 1]
            best = min(richer, key=bic, default=current)
            if bic(best) >= bic(current):
                break
            current = best
        held = fitter.validate(current)
        rms = held.rms if held is not None else math.nan
    tried = len(search.fits) - 1
    return Answer(rms, base.held_out_rms, named=current.key, note=f"{tried} structures fitted, {current.n} samples")


ARM = Arm("stepwise_bic", "Stepwise BIC, every sample counted as independent, no held-out check", fit, names="effects")
