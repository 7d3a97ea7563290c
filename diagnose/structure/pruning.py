"""Moves to smaller structures: without an effect, with a reduced form of it, or with its limit; and confounders of an effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from diagnose.fit.fitted import Fitted, key_of
from diagnose.fit.least_squares import Status
from diagnose.structure import graph
from diagnose.structure.significance import Significance
from diagnose.structure.state import State
from diagnose.thresholds import EQUIVALENT, MATERIAL
from mjsim.effects import Effect

__all__ = ["Pruning"]


@dataclass
class Pruning:
    """Fits smaller neighbours of structures and records them."""

    state: State
    significance: Significance

    def without(self, current: Fitted, effect: Effect) -> Fitted:
        """The best fit of a structure without one of its effects, from the larger structure's parameters as well."""
        return self._from(current, graph.without(current.effects, effect))

    def simplified(self, current: Fitted, effect: Effect) -> list[Callable[[], Fitted]]:
        """Fits of a structure with each reduced form of one of its effects in place of it."""
        return [partial(self._from, current, effects) for effects in graph.simplified(self.state.fitter, current, effect)]

    def limits(self, current: Fitted, effect: Effect | None = None) -> list[Callable[[], Fitted]]:
        """Fits of a structure with one of its effects, or a given one, at its limit."""
        neighbours = graph.limits(self.state.candidates, current)
        return [
            partial(self._from, current, (*others, s.effect))
            for others, s in neighbours
            if effect is None or effect.key not in key_of(others)
        ]

    def _from(self, current: Fitted, effects: tuple[Effect, ...]) -> Fitted:
        """The best fit of a structure, from the parameters of another one as well, once for each of its minima."""
        state, key = self.state, key_of(effects)
        known = state.fits.get(key)
        if known is not None and not state.once("from", key, current.key, round(math.log(current.chi2), 2)):
            return known
        h = state.fitter.hypothesis(effects, current.linear, current.own)
        f = state.fitter.fit(h, rival=True)
        state.keep(f)
        return state.fits.get(key, f)

    def eliminate(self, current: Fitted) -> Fitted:
        """Drop every effect that is not significant; try reduced forms and limits of each."""
        changed = True
        while changed and current.effects:
            changed = False
            fewer = self.state.fitter.map([partial(self.without, current, effect) for effect in current.effects])
            for effect, rest in zip(current.effects, fewer, strict=True):
                found = next((p for p in self._smaller(current, effect, rest) if not self._stands(p, current)), None)
                if found is not None:
                    current, changed = found, True
                    break
        return current

    def _smaller(self, current: Fitted, effect: Effect, rest: Fitted) -> Iterator[Fitted]:
        """A structure without an effect (``rest``), with its reduced forms, and with its limits."""
        for fit in (lambda: rest, *self.simplified(current, effect), *self.limits(current, effect)):
            p = fit()
            if p.ok and self.state.admitted([e.id for e in p.effects]):
                yield p

    def _stands(self, smaller: Fitted, current: Fitted) -> bool:
        return self.significance.significant(smaller, current) or self.significance.better_law(smaller, current)

    def fit_confounders(self, best: Fitted, effect: Effect) -> list[Fitted]:
        """Fits, from the best structure, of the confounders of one of its effects in its place; they are recorded."""
        state, fitter = self.state, self.state.fitter
        if not fitter.noise.absolute:
            return []
        # a fit that was stopped is no further from the best than it has come
        alike = [f for f in state.fits.values() if len(f.effects) == len(best.effects) and f.key != best.key]
        stopped = [f for f in alike if f.fit.status is Status.BUDGET and math.log(f.chi2 / best.chi2) < MATERIAL]
        tasks = [partial(fitter.fit, f.hypothesis, f.fit.x, rival=True) for f in stopped]
        for others, s in graph.confounders(fitter, best, effect, state.candidates):
            known = state.fits.get(tuple(sorted([*(e.key for e in others), s.candidate.key])))
            wanted = known is None or state.context.ahead(best, known) > EQUIVALENT
            if wanted and state.admitted([s.candidate.id, *(e.id for e in others)]):
                tasks.append(partial(fitter.fit, fitter.hypothesis((*others, s.effect), best.linear, best.own), rival=True))
        fits = fitter.map(tasks)
        for f in fits:
            state.keep(f)
        return fits
