"""Multistart: a structure fitted from all starts that one of its effects declares."""

from __future__ import annotations

import dataclasses
import math
from functools import partial

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.path import over_horizons, tied
from diagnose.problem.hypothesis import make
from diagnose.problem.view import MotionView
from diagnose.thresholds import COARSE, FAR, TWICE
from mjsim.effects import Effect

__all__ = ["about_nominal", "multistart"]


def about_nominal(fitter: Fitter, f: Fitted) -> Fitted:
    """The nominal structure over growing horizons, and from a fit tied to the recorded angle, as well, where it leaves much.

    ``f``: its fit from the nominal parameters, which stays where no other minimum is clearly lower. An effect that only leads
    out of a wrong minimum is no missing physics.
    """
    if not f.ok or not fitter.above(f, FAR):
        return f
    nominal = {p.name: p.value for p in fitter.nominal.chain.linear_parameters()}
    paths = (partial(over_horizons, fitter, f, nominal), partial(tied, fitter, f))
    best = min((g for g in fitter.map(paths) if g.ok), key=lambda g: g.chi2, default=f)
    best = fitter.fit(best.hypothesis, best.fit.x) if best.chi2 < f.chi2 else f
    return best if best.ok and best.chi2 < f.chi2 / TWICE**2 else f


def multistart(fitter: Fitter, f: Fitted, effect: Effect) -> Fitted:
    """The best fit of a structure from the starts of an effect at the nominal linear parameters; ``f`` where none is better.

    Of what each recording has of its own only the numbers of the other effects are kept: a start in motion, or a phase of a
    nominal effect, that was fitted without the effect compensates for it, as fitted linear parameters do. Starts are ranked by
    their cost. The best, twice as many as the effect's ``multistart``, are fitted by a few iterations by secants, in coarse steps
    of the integration, and the best of these goes on in steps of the usual size.
    """
    cls, others = type(effect), tuple(e for e in f.effects if e.key != effect.key)
    own = {k: v for k, v in f.own.items() if k[0] in {e.key for e in others}}
    values = cls.starts(fitter.scales_for(cls, effect.place))
    starts = [fitter.hypothesis((*others, make(cls.id, effect.place, v)), None, own) for v in values]
    coarse = _in_coarse_steps(fitter)
    costs = [math.inf if r is None else float(r @ r) for r in coarse.run([coarse.at_start(h) for h in starts])]
    order = sorted(range(len(starts)), key=lambda i: costs[i])[: 2 * cls.multistart]
    begin = partial(coarse.fit, iterations=8, tolerance=1e-3, secant=True, rival=True)
    best = min(fitter.map([partial(begin, starts[i]) for i in order]), key=lambda g: g.chi2, default=f)
    on = fitter.by_secants(best.hypothesis, best.fit.x) if best.ok and best is not f else f
    return on if on.ok and on.chi2 < f.chi2 else f


def _in_coarse_steps(fitter: Fitter) -> Fitter:
    """One whose free runs turn the fastest motion by ``COARSE`` in a step; itself where none is run freely."""
    view, own = fitter.view, fitter.experiments
    if not isinstance(view, MotionView):
        return fitter
    problem = fitter.problem.on(own, own, dataclasses.replace(view, step=max(view.step, COARSE)), fitter.held_out)
    return fitter.related(problem, remembers=True, counts_here=True)
