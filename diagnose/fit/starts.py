"""Starts of a fit: from the numbers of another structure, and from the starts that an effect declares."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.pool import Key
from diagnose.problem.hypothesis import Hypothesis, make
from diagnose.thresholds import STARTS_FITTED
from mjsim.effects import Effect

__all__ = ["best_of_starts", "restarted", "warm_started"]


def warm_started(fitter: Fitter, richer: Fitted, key: Key, iterations: int) -> Fitted:
    """A poorer structure ``key`` fitted from the numbers of a richer one."""
    effects = tuple(e for e in richer.effects if e.key in key)
    return fitter.fit(fitter.hypothesis(effects, richer.linear, richer.own), iterations=iterations)


def best_of_starts(fitter: Fitter, starts: Sequence[Hypothesis], most: int, tolerance: float = 1e-3) -> Fitted:
    """The best of ``most`` starts, those of the least cost, after a few iterations by secants; not `ok` where none can be run."""
    costs = [math.inf if r is None else float(r @ r) for r in fitter.run([fitter.at_start(h) for h in starts])]
    order = sorted(range(len(starts)), key=lambda i: costs[i])[:most]
    fits = fitter.map([partial(fitter.fit, starts[i], iterations=8, tolerance=tolerance, secant=True, rival=True) for i in order])
    return min(fits, key=lambda g: g.chi2)


def restarted(
    fitter: Fitter, f: Fitted, chosen: Sequence[Effect], linear: Sequence[Mapping[str, float] | None] | None = None
) -> Fitted:
    """The best fit of a structure from every start of the effects ``chosen``, at linear parameters ``linear`` (None: nominal).

    By default at its own and at the nominal ones.
    """
    starts = []
    for effect in chosen:
        cls, rest = type(effect), tuple(e for e in f.effects if e.key != effect.key)
        own = {k: v for k, v in f.own.items() if k[0] != effect.key}
        for values in cls.starts(fitter.scales_for(cls, effect.place)):
            again = (*rest, make(cls.id, effect.place, values))
            starts += [fitter.hypothesis(again, at, own) for at in linear or (f.linear, None)]
    if not starts:
        return f
    best = best_of_starts(fitter, starts, STARTS_FITTED)
    on = fitter.by_secants(best.hypothesis, best.fit.x) if best.ok else best
    return on if on.ok and on.chi2 < f.chi2 else f
