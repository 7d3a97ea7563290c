"""Moves from a structure: what is tried beside it or in place of its effects, bounded by score tests, with the cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from diagnose.fit.fitted import Fitted, key_of
from diagnose.structure import graph
from diagnose.structure.candidates import replaced
from diagnose.structure.graph import Neighbour
from diagnose.structure.halving import NONLINEAR, Halving
from diagnose.structure.score import Screened
from diagnose.structure.state import State
from diagnose.thresholds import EQUIVALENT, MOST, TWICE, UNEXPLAINED
from mjsim.effects import Effect, effect_class

__all__ = ["Move", "Moves"]


@dataclass(frozen=True)
class Move:
    """Neighbours of a structure that are fitted together.

    bound: how far C may fall below that of the base; cost: free numbers of all, times the length of a run;
    floor: the gain of C below which a neighbour is not fitted on.
    """

    name: str
    base: Fitted
    neighbours: Sequence[Neighbour]
    bound: float
    cost: float
    floor: float


@dataclass
class Moves:
    """Makes the moves from structures; each once for a residual."""

    state: State
    halving: Halving

    def add(self, base: Fitted) -> Move | None:
        """Add an effect: those whose score test exceeds the floor, and those that a score test misjudges."""
        state, context = self.state, self.state.context
        if not self._new("add", base):
            return None
        material = state.fitter.above(base, UNEXPLAINED)
        present = [e.id for e in base.effects]
        offered = [c for c in graph.additions(state.candidates, base, laws=material) if state.admitted([c.id, *present])]
        ranked = self.halving.screening(base).screen(offered)
        state.tested += len(ranked)
        floor, visible = context.floor(base), context.visible(base)
        tried = [s for s in ranked if s.gain > floor][: state.options.width]
        # a response that is not linear in the amplitude is tried while there is a residual, or a filter that may have taken it
        families = NONLINEAR if visible else NONLINEAR[:1] if len(state.fitter.whitening) > 1 else ()
        misjudged = [s for s in ranked if s not in tried and effect_class(s.candidate.id).family in families]
        if visible:  # beside a further feedback all numbers of the servo are others
            misjudged += [s for s in ranked if s not in tried and effect_class(s.candidate.id).closes_loop]
        if visible:  # so is another law in the place of a nominal effect
            misjudged += [
                s for s in ranked
                if s not in tried and s not in misjudged and effect_class(s.candidate.id).multistart > 1
                and replaced(base, s.candidate) is not None
            ]  # fmt: skip
        return self._move("add to", base, [(base.effects, s) for s in (*tried, *misjudged)], floor)

    def replace(self, base: Fitted) -> list[Move | None]:
        """Put a refinement, another law or its parts in the place of an effect of a structure."""
        if not base.effects or not self._new("replace", base):
            return []
        material = self.state.fitter.above(base, UNEXPLAINED)
        refined: list[Neighbour] = []
        for effect in base.effects:
            refined += self._screened(base, effect, laws=False)
            refined += graph.other_orders(self.state.fitter, base, effect, material=material)
        laws = self._laws(base) if material else []
        parts = graph.split(self.state.fitter, self.state.candidates, base) if material else []
        parts = [(others, s) for others, s in parts if self._untried(base, others, s)]
        limited = graph.limits(self.state.candidates, base)
        named = (("refine", refined), ("vary the law in", laws), ("split in", parts), ("take the limit in", limited))
        return [self._move(name, base, neighbours, -EQUIVALENT) for name, neighbours in named]

    def _laws(self, base: Fitted) -> list[Neighbour]:
        """Other laws of those effects of a structure that explain most of the residual: the residual may be the law's error."""
        out: list[Neighbour] = []
        for effect in base.effects:
            bare = self.state.fits.get(key_of(graph.without(base.effects, effect)))
            if bare is None or base.chi2 < MOST * bare.chi2:
                out += self._screened(base, effect, laws=True)
        return out

    def _screened(self, base: Fitted, effect: Effect, *, laws: bool) -> list[Neighbour]:
        """What refines an effect of a structure, or its other laws, where the score test exceeds the floor or misjudges."""
        state, others = self.state, graph.without(base.effects, effect)
        supposed = [
            c for c in graph.replacements(state.candidates, base, effect, laws=laws)
            if state.admitted([c.id, *(e.id for e in others)])
        ]  # fmt: skip
        ranked = self.halving.screening(base).screen(supposed, effect)
        state.tested += len(ranked)
        floor = state.context.floor(base)
        likely = [s for s in ranked if s.gain > floor or effect_class(s.candidate.id).multistart > 1]
        return [(others, s) for s in likely if self._untried(base, others, s)]

    def _untried(self, base: Fitted, others: tuple[Effect, ...], s: Screened) -> bool:
        """Whether a structure was not fitted, or has a larger error than the base, whose parameters may lead to a better fit."""
        known = self.state.fits.get(tuple(sorted([*(e.key for e in others), s.candidate.key])))
        return known is None or known.chi2 > base.chi2

    def _new(self, name: str, base: Fitted) -> bool:
        """Whether a move was not made from this residual by the present orders, and anything is left to be explained."""
        return base.chi2 > 0.0 and self.state.once(name, base.key, round(math.log(base.chi2), 1), self.state.fitter.orders)

    def _move(self, name: str, base: Fitted, neighbours: Sequence[Neighbour], floor: float) -> Move | None:
        if not neighbours:
            return None
        bound = max(self._bound(base, s) for _, s in neighbours)
        numbers = sum(len(base.hypothesis.entries) + len(s.effect.values) for _, s in neighbours)
        return Move(name, base, tuple(neighbours), bound, numbers * self.state.fitter.length(base.hypothesis, base.fit.x), floor)

    def _bound(self, base: Fitted, s: Screened) -> float:
        """How far C may fall: ``TWICE`` times what the score test says, and to the noise where the response is not linear.

        Where neither the score test nor the noise tells, half of the residual is supposed.
        """
        absolute, cls = self.state.fitter.noise.absolute, effect_class(s.candidate.id)
        if base.chi2 <= 0.0:
            return 0.0
        if not math.isfinite(s.gain):
            left = base.n if absolute else 0.5 * base.chi2
        elif absolute:
            nonlinear = cls.multistart > 1 or cls.rough or cls.family in NONLINEAR
            least = min(base.n, base.chi2 - s.gain)  # nothing explains noise, unless the score test says so
            left = least if nonlinear else max(base.chi2 - TWICE * s.gain, least)
        else:
            left = base.chi2 - TWICE * s.gain
        left = max(left, 1e-3 * base.chi2)
        return base.n * self.state.context.effective * math.log(base.chi2 / left)
