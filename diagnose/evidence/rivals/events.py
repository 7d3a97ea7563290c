"""Another order of events as the rival of what is added to a nonsmooth structure.

A free run that sticks once too often is wrong from there on, and whatever moves that event gains much. Under an observer gain a
model is put right within 1 / gain: there the added effect must gain as well, a fair part of that. Of more than noise it must
explain a fair part.
"""

from __future__ import annotations

import math

from diagnose.evidence.context import Context
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto
from diagnose.fit.fits import Key
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.path import observed
from diagnose.thresholds import FAIR, OBSERVER_GAINS, SAME, UNEXPLAINED

__all__ = ["no_moment_of_an_event"]


def no_moment_of_an_event(context: Context, pair: Pair) -> Outcome:
    """Refuse an effect that gains in the free run alone, or too little of the residual."""
    before, after = pair.before, pair.after
    if not before.rough or not context.fitter.noise.absolute or not pair.nested:
        return PASS
    gain = context.gain(before, after)
    if before.chi2 > UNEXPLAINED * before.n:
        needed = FAIR * before.n * math.log(before.chi2 / before.n)
        if gain < needed:
            return Veto("events", {"gain": gain, "needed": needed})
    found, needed = _gain_under_observer(context, before, after), max(context.prices.entry, FAIR * gain)
    return Veto("events", {"gain": found, "needed": needed}) if found < needed else PASS


def _gain_under_observer(context: Context, before: Fitted, after: Fitted) -> float:
    """The gain in C under the lowest of ``OBSERVER_GAINS``; infinite where one of the two cannot be run so."""
    fitter, memo = context.fitter, context.memo.observed
    asked = next((a for a in memo if _alike(a, before, after)), (before.key, before.chi2, after.key, after.chi2))
    if asked not in memo:
        gain = OBSERVER_GAINS[0]
        richer, own = (observed(fitter, f, gain, 15, spread=8, keep=2) for f in (after, before))
        started = _warm_started(fitter, after, before.key)
        poorer = [f for f in (own, observed(fitter, started, gain, 15) if started.ok else None) if f is not None]
        if richer is None or not poorer:
            memo[asked] = math.inf
        else:
            memo[asked] = context.gain(min(poorer, key=lambda f: f.chi2), richer)
    return memo[asked]


def _alike(asked: tuple[Key, float, Key, float], before: Fitted, after: Fitted) -> bool:
    """Whether two structures are those that were asked about, by keys and chi-squares, but for the last digits of a fit."""
    same = (asked[0], asked[2]) == (before.key, after.key)
    return same and all(abs(math.log(f.chi2 / known)) < SAME for f, known in ((before, asked[1]), (after, asked[3])))


def _warm_started(fitter: Fitter, richer: Fitted, key: Key) -> Fitted:
    """A poorer structure at the parameters of a richer one."""
    effects = tuple(e for e in richer.effects if e.key in key)
    return fitter.fit(fitter.hypothesis(effects, richer.linear, richer.own), iterations=0)
