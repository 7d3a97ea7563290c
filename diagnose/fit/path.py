"""Continuation: a structure fitted along relaxed problems to the free run.

An observer gain corrects the model by the measured velocity and falls to zero; a horizon grows to the whole recording; restarts
about a fit follow its covariance. Source: C. P. Vyasarayani et al., Multibody Syst. Dyn. 26 (2011) 411.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView, most_led
from diagnose.thresholds import CLOSELY, DRAWS, FEW_GAINS, GAINS, HORIZONS, LOST, PATIENCE, RESTARTS, SAME, WRONG

__all__ = ["landed", "observed", "over_horizons", "released", "restarted_about"]


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
    if not isinstance(fitter.view, MotionView) or gain > most_led(fitted.axis):
        return None
    asked = (gain, iterations, secant, fitted.key, fitted.chi2, fitter.prior_weight, fitter.whitening.tobytes())
    if not spread and asked in fitter.engine.observed:
        known: Fitted | None = fitter.engine.observed[asked]
        return known
    part = fitter.beside(fitter.problem.under_observer(gain))
    h, x = fitted.hypothesis, fitted.fit.x
    starts = [x, *fitted.drawn(np.geomspace(1.0, 30.0, spread), seed)]
    answers = fitter.run([partial(part.residual(h), s) for s in starts])
    costs = [math.inf if r is None else float(r @ r) for r in answers]
    order = sorted(range(len(starts)), key=lambda i: costs[i])[:keep]
    chosen = order if 0 in order else [*order[:-1], 0]
    secant |= spread > 0
    fits = fitter.map([partial(part.fit, h, starts[i], iterations=iterations, tolerance=1e-4, secant=secant) for i in chosen])
    fitter.took(part.work)
    best = min((f for f in fits if f.ok), key=lambda f: f.chi2, default=None)
    if not spread:
        fitter.engine.observed[asked] = best
    return best


def released(fitter: Fitter, fitted: Fitted, seed: int = 0, highest: float = math.inf) -> Fitted | None:
    """A structure fitted along falling observer gains to the free run, from points about each fit as well.

    A nonsmooth free run has a minimum for each order of its events; under an observer gain a model is soon put right. None where
    there can be no such gain, or more than noise is left under the first: something else is missing than those moments.
    ``highest``: the gain [1/s] at which it begins.
    """
    now, least, idle = fitted, math.inf, 0
    highest = min(highest, most_led(fitted.axis))
    for k, gain in enumerate(g for g in GAINS if g <= highest):
        if fitter.spent:
            break
        best, idle = _at_gain(fitter, now, gain, k, seed, least, idle)
        if best is None or (not k and best.chi2 > WRONG * best.n):
            return None
        now, least = best, min(least, best.chi2)
        if now.chi2 > (LOST if gain >= CLOSELY else WRONG) * max(least, now.n):
            break  # from here it would only come to another order of events; under a close gain it lacks something else
    return fitter.fit(now.hypothesis, now.fit.x, iterations=20)


def _at_gain(fitter: Fitter, now: Fitted, gain: float, k: int, seed: int, least: float, idle: int) -> tuple[Fitted | None, int]:
    """The best fit under the k-th gain, drawn again while an event seems lost; and how many draws in a row led nowhere."""
    best: Fitted | None = None
    for draw in range(DRAWS if k else 1):
        spread = 16 if k or seed or draw else 0
        at = len(GAINS) * (DRAWS * seed + draw) + k
        found = observed(fitter, now if best is None else best, gain, 6 if k else 20, spread=spread, keep=3, seed=at)
        if found is None:
            return None, idle
        same = best is not None and abs(math.log(found.chi2 / best.chi2)) < SAME
        best = found if best is None or found.chi2 < best.chi2 else best
        idle = idle + 1 if same else 0 if draw else idle
        if idle >= PATIENCE or same:
            break  # points about the best lead nowhere: no event was lost
        if best.chi2 < (LOST * max(least, best.n) if k else WRONG * best.n):
            break
    return best, idle


def landed(fitter: Fitter, fitted: Fitted) -> Fitted | None:
    """A structure fitted along few falling observer gains to the free run; None where it lacks something else."""
    now = fitted
    for k, gain in enumerate(g for g in FEW_GAINS if g <= most_led(fitted.axis)):
        found = observed(fitter, now, gain, 20, secant=k > 0)  # from one gain to the next the sensitivities hardly change
        if found is None or fitter.spent or (not k and found.chi2 > WRONG * found.n):
            return None
        now = found
    return fitter.by_secants(now.hypothesis, now.fit.x)


def restarted_about(fitter: Fitter, fitted: Fitted) -> Fitted:
    """A structure fitted from points drawn about its fit, as long as one of them leads to a lower minimum.

    The minima of a nonsmooth cost are many and narrow: an event a sample sooner is another one. No gradient leads
    from one to the next; points by the covariance of the fit, ever wider, do.
    """
    idle = 0
    for turn in range(RESTARTS):
        if fitter.spent:
            break
        points = fitted.drawn(np.geomspace(0.3, 30.0, 24), turn)
        answers = fitter.run([partial(fitter.residual(fitted.hypothesis), x) for x in points])
        costs = [math.inf if r is None else float(r @ r) for r in answers]
        chosen = sorted(range(len(points)), key=lambda i: costs[i])[:2]
        begin = partial(fitter.fit, fitted.hypothesis, iterations=6, tolerance=1e-4, secant=True)
        fits = fitter.map([partial(begin, points[i]) for i in chosen if costs[i] < 2.0 * fitted.chi2])
        best = min((f for f in fits if f.ok), key=lambda f: f.chi2, default=fitted)
        idle = 0 if best.chi2 < fitted.chi2 - 1.0 else idle + 1
        fitted = best if best.chi2 < fitted.chi2 else fitted
        if idle == PATIENCE:
            break
    return fitted


def over_horizons(fitter: Fitter, fitted: Fitted, linear: Mapping[str, float] | None, iterations: int = 12) -> Fitted:
    """A structure fitted to the first stretch of each recording, then to ever longer ones, and then to all of it.

    A long free run has many minima: an oscillation that is off by a turn fits worse on the way to the right one than where it
    is. Over a short stretch it is not yet off by a turn.
    """
    effects, own = fitted.effects, fitted.own
    for share in HORIZONS:
        stretches = tuple(e.first(share) for e in fitter.experiments)
        part = fitter.beside(fitter.problem.on(stretches, fitter.experiments))
        found = part.fit(part.hypothesis(effects, linear, own), iterations=iterations)
        fitter.took(part.work)
        if not found.ok or fitter.spent:
            return fitted
        effects, linear, own = found.effects, found.linear, found.own
    return fitter.fit(fitter.hypothesis(effects, linear, own), iterations=20)
