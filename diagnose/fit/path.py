"""Relaxed problems, which have fewer minima than the free run.

Under an observer gain the measured velocity corrects the model; a horizon grows to the whole recording.
Source: C. P. Vyasarayani et al., Multibody Syst. Dyn. 26 (2011) 411.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView, highest_observer_gain
from diagnose.thresholds import HORIZONS, OBSERVER_GAINS

__all__ = ["observed", "over_horizons", "relaxed", "tied"]


def observed(
    fitter: Fitter,
    fitted: Fitted,
    gain: float,
    iterations: int = 10,
    *,
    spread: int = 0,
    keep: int = 1,
    seed: int = 0,
    secant: bool = False,
) -> Fitted | None:
    """A structure fitted under an observer gain [1/s]: the model is corrected by its own inertia times gain times velocity error.

    ``spread``: from so many further points about it too, drawn by its covariance, ever wider; the best ``keep`` go on. None
    where a lag of the sensor leaves no room for so high a gain. Known without a spread, it is not fitted again.
    """
    if not isinstance(fitter.view, MotionView) or gain > highest_observer_gain(fitted.axis):
        return None
    asked = (gain, iterations, secant, fitted.key, fitted.chi2, fitter.prior_weight, fitter.whitening.tobytes())
    if not spread and asked in fitter.engine.observed:
        known: Fitted | None = fitter.engine.observed[asked]
        return known
    part = fitter.related(fitter.problem.under_observer(gain))
    h, x = fitted.hypothesis, fitted.fit.x
    starts = [x, *fitted.covariance_draws(np.geomspace(1.0, 30.0, spread), seed)]
    answers = fitter.run([partial(part.residual(h), s) for s in starts])
    costs = [math.inf if r is None else float(r @ r) for r in answers]
    order = sorted(range(len(starts)), key=lambda i: costs[i])[:keep]
    chosen = order if 0 in order else [*order[:-1], 0]
    secant |= spread > 0
    fits = fitter.map([partial(part.fit, h, starts[i], iterations=iterations, tolerance=1e-4, secant=secant) for i in chosen])
    fitter.count_work(part.work)
    best = min((f for f in fits if f.ok), key=lambda f: f.chi2, default=None)
    if not spread:
        fitter.engine.observed[asked] = best
    return best


def relaxed(fitter: Fitter, fitted: Fitted) -> Fitted:
    """A nonsmooth structure fitted along falling observer gains to the free run, from points about each fit as well.

    A free run has a minimum for each order of its events; under an observer gain an event at another time costs little. The fit
    itself where that leads to no lower minimum.
    """
    now = fitted
    for gain in (g for g in sorted(OBSERVER_GAINS, reverse=True) if g <= highest_observer_gain(fitted.axis)):
        found = observed(fitter, now, gain, 10, spread=8, keep=2)
        if found is None or fitter.spent:
            return fitted
        now = found
    h, starts = now.hypothesis, [now.fit.x, *now.covariance_draws(np.geomspace(0.3, 30.0, 24), 0)]
    costs = [math.inf if r is None else float(r @ r) for r in fitter.run([partial(fitter.residual(h), x) for x in starts])]
    order = sorted(range(len(starts)), key=lambda i: costs[i])[:2]
    best = min(fitter.map([partial(fitter.by_secants, h, starts[i]) for i in order]), key=lambda f: f.chi2)
    return best if best.ok and best.chi2 < fitted.chi2 else fitted


def tied(fitter: Fitter, fitted: Fitted) -> Fitted:
    """A structure fitted with gravity and springs at the recorded angle, and from there with these at its own.

    A swing that goes otherwise than the recorded one is a minimum of its own; where the angle is given there is none. The fit
    itself where nothing holds the axis in place.
    """
    if not fitter.problem.holds:
        return fitted
    part = fitter.related(fitter.problem.tied())
    found = part.fit(fitted.hypothesis)
    fitter.count_work(part.work)
    return fitter.fit(fitted.hypothesis, found.fit.x) if found.ok else fitted


def over_horizons(fitter: Fitter, fitted: Fitted, linear: Mapping[str, float] | None, iterations: int = 12) -> Fitted:
    """A structure fitted to the first stretch of each recording, then to ever longer ones, and then to all of it.

    A long free run has many minima: an oscillation that is off by a turn fits worse on the way to the right one than where it
    is. Over a short stretch it is not yet off by a turn.
    """
    effects, own = fitted.effects, fitted.own
    for share in HORIZONS[:-1]:
        stretches = tuple(e.first(share) for e in fitter.experiments)
        part = fitter.related(fitter.problem.on(stretches, fitter.experiments))
        found = part.fit(part.hypothesis(effects, linear, own), iterations=iterations)
        fitter.count_work(part.work)
        if not found.ok or fitter.spent:
            return fitted
        effects, linear, own = found.effects, found.linear, found.own
    return fitter.fit(fitter.hypothesis(effects, linear, own), iterations=20)
