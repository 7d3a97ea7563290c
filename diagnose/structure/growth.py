"""Moves to richer structures and beside them: add an effect, refine one, exchange one for another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from diagnose.fit.fitted import Fitted, key_of
from diagnose.structure.candidates import Candidate, Screened, conflicts, related, replaced, takes_place
from diagnose.structure.continuation import Continuation
from diagnose.structure.moves import Entrant, ground, in_place, other_orders, taken_apart
from diagnose.structure.multistart import Multistart
from diagnose.structure.race import CURVED, Race
from diagnose.structure.selection import Selection
from diagnose.structure.state import State
from diagnose.thresholds import (
    FEWER,
    FROM_AFAR,
    HOPEFUL,
    INEXACT,
    LACKS,
    MISFIT,
    ONE_MOTION,
    OTHER_ORDER,
    PROMISING,
    RESTARTED_BELOW,
    RIVAL,
    UNEXPLAINED,
)
from mjsim.effects import Effect, effect_class

__all__ = ["Growth"]


@dataclass
class Growth:
    """Fits neighbours of structures that are as rich or richer; the pool keeps them."""

    state: State
    path: Continuation
    selection: Selection
    starts: Multistart
    race: Race

    def expand(self, base: Fitted) -> list[Fitted]:
        """Fit the most promising structures with one effect more than ``base``."""
        state = self.state
        if state.spent():
            return []
        landed = self._landed(base)
        if landed is None:
            return []  # what it comes to is built on in its place
        base = landed
        ranked = self.race.look(base).screen(self.additions(base))
        state.screened[base.key] = ranked
        state.tested += len(ranked)
        floor, visible = state.context.floor(base), state.context.visible(base)
        tried = self._chosen(base, ranked, floor, visible)
        grown = self.race.run(base, [(base.effects, s) for s in tried], floor)
        # under an observer gain a model has hardly any minima but one, and its parameters do not go astray
        if not visible or not state.options.free or not tried or state.spent():
            return grown
        self.starts.from_nominal(base, grown, CURVED[:1])
        grown = [state.pool.newest(f) for f in grown]
        if tried[0] is not ranked[0]:
            return grown
        short = self.starts.short_of_promise(base, tried[0])
        return grown if short is None else [short, *(f for f in grown if f.key != short.key)]

    def _landed(self, base: Fitted) -> Fitted | None:
        """A structure to expand: a nonsmooth one near the noise once it has landed; None where a limit of it is better."""
        state = self.state
        if not base.rough or base.chi2 >= RESTARTED_BELOW * base.n:
            return base
        self.starts.limits(base)  # a minute error may be that of an event a sample too late
        if self.selection.best(base).key != base.key:
            return None
        self.path.land(base)
        return state.pool.newest(base)

    def _chosen(self, base: Fitted, ranked: Sequence[Screened], floor: float, visible: bool) -> list[Screened]:
        """What is fitted in full, of what was screened: the first that promise enough, and those that a score test misjudges."""
        state, fitter = self.state, self.state.fitter
        tried = [s for s in ranked if s.gain > floor][: state.options.width if visible else FEWER]
        # a response that is not linear in its amplitude: fitted whatever the secant says, while there is something to explain, or
        # (a structure) a filter that may have taken it in
        whatever = CURVED if visible else CURVED[:1] if len(fitter.whitening) > 1 else ()
        tried += [s for s in ranked if effect_class(s.candidate.id).family in whatever and s not in tried]
        if not base.effects and visible and fitter.above(base, MISFIT):
            keys = {s.candidate.key for s in tried}
            tried += [
                s for s in self.race.look(base).from_nominal(self.additions(base)) if s.candidate.key not in keys
            ]  # fmt: skip
        # nor is that of another law in the place of one that the nominal axis has
        folds = [s for s in ranked if visible and effect_class(s.candidate.id).multistart > 1 and s not in tried]
        return tried + [s for s in folds if replaced(base, s.candidate) is not None]

    def additions(self, base: Fitted) -> list[Candidate]:
        """What may be added to a structure.

        Another law of an effect is tried in its place, where that leaves something material: of one that stands in the structure
        by `refine`, of one that the nominal axis has here.
        """
        material = self.state.fitter.above(base, UNEXPLAINED)
        return [
            c for c in self.state.candidates
            if not conflicts(c, base.effects) and (not effect_class(c.id).form_of or (material and replaced(base, c) is not None))
            and self.state.admitted([c.id, *(e.id for e in base.effects)])
        ]  # fmt: skip

    def promises(self, best: Fitted, expanded: set[tuple[str, ...]]) -> bool:
        """Whether something promises to take up nearly all that the simplest form of a structure leaves far from the noise.

        It is tried before all that is dear: refinements, other laws, observer gains.
        """
        state, base = self.state, ground(best, self.state.pool)
        far = state.fitter.above(base, LACKS)
        if not far or base.key in expanded or len(base.effects) >= state.options.depth or state.spent():
            return False
        ranked = self.race.look(base).screen(self.additions(base))
        return bool(ranked) and base.chi2 - ranked[0].gain < PROMISING * base.chi2

    def refine(self, base: Fitted, *, forms: bool = False) -> list[Fitted]:
        """Fit the structures in which an effect of ``base`` is replaced by one that refines it.

        Where the score says it can matter; by other laws (``forms``) where it leaves something material, or if asked for.
        """
        state, criterion = self.state, self.state.context.criterion
        if state.spent():
            return []
        limits = self.starts.limits(base)
        if any(criterion(f) < criterion(base) for f in limits):
            return limits  # of fewer numbers: it is gone on with
        material = (forms and state.fitter.noise.absolute) or state.fitter.above(base, UNEXPLAINED)
        grown = self.race.run(base, self._refinements(base, material=material))
        least = min((f.chi2 for f in grown), default=math.inf)
        if material and least > INEXACT * base.chi2:  # else the better effect is gone on with, and not the law of this one
            grown = [*grown, *self.race.run(base, self._other_laws(base, forms=forms), least=least)]
        if grown and state.context.slow(first := min(grown, key=criterion)):
            self.starts.limits(first)
        return grown

    def _refinements(self, base: Fitted, *, material: bool) -> list[Entrant]:
        """What may refine an effect of a structure in its place: other effects, and itself at other orders or taken apart."""
        state, entrants = self.state, list[Entrant]()
        for effect in base.effects:
            others = tuple(e for e in base.effects if e.key != effect.key)
            entrants += self._in_place_of(base, effect, others, law=False)
            mark = (base.key, (effect.key, str(state.fitter.orders)))
            if mark not in state.tried:
                state.tried.add(mark)
                entrants += other_orders(state.fitter, effect, others, material=material)
            apart = taken_apart(state.fitter, state.candidates, effect, others) if material else []
            entrants += self._new(base, apart)
        return entrants

    def _other_laws(self, base: Fitted, *, forms: bool) -> list[Entrant]:
        """The effects of a structure by other laws, where they explain so much that only the law may be wrong, or if asked."""
        entrants: list[Entrant] = []
        for effect in base.effects:
            others = tuple(e for e in base.effects if e.key != effect.key)
            bare = self.state.pool.get(key_of(others))
            if forms or bare is None or base.chi2 < INEXACT * bare.chi2:
                entrants += self._in_place_of(base, effect, others, law=True)
        return entrants

    def _in_place_of(self, base: Fitted, effect: Effect, others: tuple[Effect, ...], *, law: bool) -> list[Entrant]:
        """What the screen lets take the place of an effect of a structure: effects of their own, or other laws (``law``)."""
        supposed = [
            c for c in self.state.candidates
            if takes_place(c, effect) and c.id != effect.id and not conflicts(c, others)
            and bool(effect_class(c.id).form_of) == law
            and related(c.id, effect) and self.state.admitted([c.id, *(e.id for e in others)])
            and self._untried(base, tuple(sorted([*(e.key for e in others), c.key])), c.key)
        ]  # fmt: skip
        ranked = self.race.look(base).screen(supposed, effect)
        self.state.tested += len(ranked)
        worth = HOPEFUL * self.state.options.entry
        return [(others, s) for s in ranked if s.gain > worth or effect_class(s.candidate.id).multistart > 1]

    def exchange(self, base: Fitted) -> list[Fitted]:
        """Fit the structures in which an effect of ``base`` gives way to one that did as much as it beside a simpler structure.

        What has entered since may tell them apart, or it may be what kept the better one from being seen.
        """
        return self._exchanged(base, RIVAL)

    def exchange_confounders(self, base: Fitted) -> list[Fitted]:
        """The same of what made one and the same motion."""
        return self._exchanged(base, ONE_MOTION)

    def _exchanged(self, base: Fitted, within: float) -> list[Fitted]:
        """``within``: largest difference in the logarithm of chi-square beside a simpler structure."""
        state = self.state
        if not state.fitter.above(base, UNEXPLAINED) or state.spent():
            return []
        return self.race.run(base, self._new(base, in_place(state.pool, state.candidates, base, within)))

    def _new(self, base: Fitted, entrants: Sequence[Entrant]) -> list[Entrant]:
        """Those that are admitted and were not tried from here."""
        new = [
            (others, s) for others, s in entrants
            if self.state.admitted([s.candidate.id, *(e.id for e in others)])
            and self._untried(base, tuple(sorted([*(e.key for e in others), s.candidate.key])), s.candidate.key)
        ]  # fmt: skip
        self.state.tested += len(new)
        return new

    def _untried(self, base: Fitted, key: tuple[str, ...], entrant: str) -> bool:
        """Whether a structure was not fitted yet, or from so far off that it may do better from here; once as the base is now.

        Or the effect ``entrant`` of it is locked to position at another order than the one that now stands out most.
        """
        state, known = self.state, self.state.pool.get(key)
        elsewhere = known is not None and self._at_another_order(known, entrant)
        mark = (base.key, (*key, f"{math.log(base.chi2):.1f}", str(state.fitter.orders) if elsewhere else ""))
        near = known is not None and known.chi2 < FROM_AFAR * base.chi2 and not elsewhere
        if known is not None and (near or mark in state.tried):
            return False
        state.tried.add(mark)
        return True

    def _at_another_order(self, f: Fitted, key: str) -> bool:
        """Whether an effect of a structure is locked to position at another order than the one that now stands out most."""
        effect = next(e for e in f.effects if e.key == key)
        orders = self.state.fitter.scales_for(type(effect), effect.place).orders
        cycles = effect.values.get("cycles_per_rev")
        return cycles is not None and bool(orders) and abs(orders[0] - cycles) > OTHER_ORDER * cycles
