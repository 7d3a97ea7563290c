"""Moves to poorer structures: leave an effect out, put a simpler law in its place; and rivals that may do as much."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from diagnose.fit.fitted import Fitted, key_of
from diagnose.fit.least_squares import Status
from diagnose.problem.hypothesis import make
from diagnose.structure.continuation import Continuation
from diagnose.structure.moves import imitators
from diagnose.structure.multistart import Multistart
from diagnose.structure.significance import Significance, warm_mark
from diagnose.structure.state import State
from diagnose.thresholds import ALIKE_C, CRAWLS, ELSEWHERE, FORMS, LITTLE, SAME, UNEXPLAINED
from mjsim.effects import Effect, effect_class

__all__ = ["Reduction"]


@dataclass
class Reduction:
    """Fits poorer neighbours of structures; the pool keeps them."""

    state: State
    path: Continuation
    significance: Significance
    starts: Multistart

    def without(self, current: Fitted, effect: Effect) -> Fitted:
        """The best fit of a structure without one of its effects: its own, and one from the richer structure's numbers."""
        state, fitter, pool = self.state, self.state.fitter, self.state.pool
        rest = tuple(e for e in current.effects if e.key != effect.key)
        known = pool.get(key_of(rest))
        asked = warm_mark(key_of(rest), current)
        if known is not None and asked in state.warm:
            return known
        state.warm.add(asked)
        h = fitter.hypothesis(rest, current.linear, current.own)
        if known is not None and known.fit.status is Status.CONVERGED and not rest:
            (r,) = fitter.run([fitter.at_start(h)])
            if r is None or float(r @ r) > ELSEWHERE * known.chi2:  # else it may be a wrong minimum, which the effect has left
                return known
        slow = self._near(current) if h.rough or state.late() else (math.inf, 0.0)
        on = partial(fitter.fit, iterations=FORMS, rival=True, slow=slow)
        begun = on(h)
        state.keep(begun)
        if known is not None and known.fit.status is not Status.CONVERGED:
            state.keep(on(known.hypothesis, known.fit.x))
        return pool.get(key_of(rest), begun)

    def eliminate(self, current: Fitted) -> Fitted:
        """Drop every effect that is not significant; try simpler forms of each."""
        changed = True
        while changed and current.effects:
            changed = False
            fewer = self.state.fitter.map([partial(self.without, current, effect) for effect in current.effects])
            for effect, rest in zip(current.effects, fewer, strict=True):
                found = next((p for p in self._poorer(current, effect, rest) if not self._keeps(p, current)), None)
                if found is not None:
                    current, changed = found, True
                    break
        return current

    def _poorer(self, current: Fitted, effect: Effect, rest: Fitted) -> Iterator[Fitted]:
        """A structure without an effect (``rest``), or with the simpler forms that it refines.

        A refinement may have entered while another effect was missing.
        """
        for fit in (lambda: rest, *self.simpler(current, effect)):
            p = fit()
            if p.ok and self.state.admitted([e.id for e in p.effects]):
                yield p

    def _keeps(self, poorer: Fitted, current: Fitted) -> bool:
        return self.significance.significant(poorer, current) or self.significance.better_law(poorer, current)

    def _near(self, current: Fitted) -> tuple[float, float]:
        """How long a poorer structure is fitted on: as long as it may come near. The cost of a nonsmooth one falls for ever.

        Under an observer gain it is a base to build on.
        """
        return (math.exp(FORMS * CRAWLS) * current.chi2, CRAWLS) if self.state.options.free else (math.inf, 0.0)

    def simpler(self, current: Fitted, effect: Effect) -> list[Callable[[], Fitted]]:
        """Fits of a structure with each simpler form of one of its effects in place of it."""
        rest = tuple(e for e in current.effects if e.key != effect.key)
        present = {e.key for e in (*rest, *self.state.fitter.nominal.effects)}
        return [
            partial(self._simpler, current, effect, rest, name) for name in type(effect).refines
            if effect.place in effect_class(name).places and f"{name}@{effect.place}" not in present
        ]  # fmt: skip

    def _simpler(self, current: Fitted, effect: Effect, rest: tuple[Effect, ...], name: str) -> Fitted:
        """A structure with the effect ``name`` in place of one that refines it, at the numbers that they share."""
        fitter, pool, cls = self.state.fitter, self.state.pool, effect_class(name)
        values = dict(cls.starts(fitter.scales_for(cls, effect.place))[0])
        values.update({k: v for k, v in effect.values.items() if k in values})
        h = fitter.hypothesis((*rest, make(name, effect.place, values)), current.linear, current.own)
        simple = fitter.fit(h, iterations=FORMS, rival=True, slow=self._near(current))
        self.state.keep(simple)
        bare = pool.get(key_of(rest))
        behind = simple.ok and math.log(simple.chi2 / current.chi2) > SAME
        if behind and (bare is None or simple.chi2 < bare.chi2):  # else it has come to nothing from there
            self.path.grow([simple], current)  # a rival that has stalled is not beaten
        return pool.newest(simple)

    def fit_confounders(self, best: Fitted, effect: Effect) -> None:
        """Fit, from the best structure, what may do as much as one of its effects in its place; the pool keeps them."""
        state, fitter, pool = self.state, self.state.fitter, self.state.pool
        if not fitter.noise.absolute:
            return
        if not state.spent():
            self.starts.limits(best)
        # a rival that its race has left before it had converged is no further off than it has come, whatever may still be taken
        alike = [f for f in pool.values() if len(f.effects) == len(best.effects) and f.key != best.key]
        left = [f for f in alike if f.fit.status is Status.BUDGET and math.log(f.chi2 / best.chi2) < LITTLE]
        fits = [partial(fitter.fit, f.hypothesis, f.fit.x, rival=True) for f in left]
        # nor is what cannot be told from an answer left out for that: it is a part of the answer
        answers = not state.spent() or fitter.misfit(best) < UNEXPLAINED
        for others, s in imitators(fitter, best, effect, state.candidates) if answers else ():
            known = pool.get(tuple(sorted([*(e.key for e in others), s.candidate.key])))
            wanted = known is None or state.context.ahead(best, known) > ALIKE_C
            if state.admitted([s.candidate.id, *(e.id for e in others)]) and wanted:
                fits.append(partial(fitter.fit, fitter.hypothesis((*others, s.effect), best.linear, best.own), rival=True))
        for f in fitter.map(fits):
            state.keep(f)
