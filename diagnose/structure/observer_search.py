"""A short search among models that the measured velocity leads closely: which structure to begin a free run from.

Led, a model has hardly any minima but one, whatever else is missing. In a free run a gap, stiction or a hidden mode has many, so
that the right one of a pair may be fitted ever so badly until the other is there, and other effects enter in its place.
"""

from __future__ import annotations

import dataclasses

from diagnose.fit.fitted import Fitted
from diagnose.fit.path import observed, released
from diagnose.fit.starts import restarted, warm_started
from diagnose.structure.moves import folded, formed, ground
from diagnose.structure.search import Search
from diagnose.thresholds import (
    CLOSELY,
    LACKS,
    LEADS_NOWHERE,
    MOMENTS,
    MOST_RELEASED,
    OBSERVER_PART,
    REFINED_BELOW,
    RELEASED_WITHIN,
    ROUNDS,
    UNEXPLAINED,
    WIDTH,
    WRONG,
)

__all__ = ["among_led"]


def among_led(search: Search) -> None:
    """Add to a search, as free runs, the structures that leave no more than moments of their events when they are led closely.

    The simplest first, until one of them leaves no more than noise.
    """
    for led in _search(search):
        free = search.fitter.fit(search.fitter.hypothesis(led.effects, led.linear, led.own), iterations=20)
        search.keep(free)
        missed = search.path.restart(free).chi2 > UNEXPLAINED * min(free.n, led.chi2)
        if missed and led.chi2 < MOMENTS * led.n:  # else it lacks more than those, and is where to go on from
            again = released(search.fitter, led, highest=CLOSELY)
            search.keep(free if again is None else again)
        known = search.pool.get(led.key)  # none where no free run of it could be fitted
        if known is not None and known.chi2 < UNEXPLAINED * known.n:
            break


def _search(search: Search) -> list[Fitted]:
    """The structures, led closely, those of the fewest numbers first."""
    problem = search.fitter.problem.under_observer(CLOSELY, search.fitter.held_out).relax(prior_weight=1.0)
    led = search.fitter.beside(problem, counts_here=True)
    led.allow(led.runs + OBSERVER_PART * (search.fitter.most_runs - led.runs))
    chosen = dataclasses.replace(search.options, width=WIDTH, beam=1, free=False)
    other = Search(led, chosen, progress=search.progress)
    other.state.only_beside = search.state.only_beside
    other.state.consider(search.state.candidates)
    best = other.nominal()
    for _ in range(ROUNDS):
        if not best.ok or led.spent or best.chi2 < WRONG * best.n:
            break
        before = other.tempering.tempered(best)
        base = ground(before, other.pool)
        other.growth.expand(base)
        best = other.tempering.tempered(_least(other))
        if base.effects and set(base.key) < set(best.key):  # it may have missed the minimum to which what was added has led
            other.keep(warm_started(other.fitter, best, base.key, 12))
        refined: set[tuple[str, ...]] = set()
        while best.key not in refined and WRONG < best.chi2 / best.n < REFINED_BELOW and not led.spent:
            refined.add(best.key)
            other.growth.refine(best)
            best = other.tempering.tempered(_least(other))
        if WRONG < best.chi2 / best.n < REFINED_BELOW and not led.spent:
            other.keep(restarted(other.fitter, best, [e for e in best.effects if type(e).rough]))
            best = other.pool[best.key]
        if best.chi2 > LEADS_NOWHERE * before.chi2:
            break
        for effect in best.effects if best.chi2 > WRONG * best.n else ():
            for simpler in other.reduction.simpler(best, effect):  # what is missing is sought beside the simplest form
                simpler()
    led.allow(search.fitter.most_runs)
    found = [f for f in other.pool.values() if f.effects and f.chi2 < min(LACKS * f.n, RELEASED_WITHIN * best.chi2)]
    found = sorted(found, key=lambda f: (formed(f), len(f.hypothesis.entries), f.chi2))[:MOST_RELEASED]
    found = [_spread(other, f) for f in found]
    search.state.tested += other.tested
    return found


def _least(search: Search) -> Fitted:
    """The best structure of a pool."""
    return min(search.pool.values(), key=search.criterion)


def _spread(search: Search, f: Fitted) -> Fitted:
    """The best fit of a structure from points about it as well, where its error may have several minima."""
    found = observed(search.fitter, f, CLOSELY, 12, spread=12, keep=3) if folded(f) else None
    if found is not None and found.chi2 < f.chi2:
        search.keep(found)
        return found
    return f
