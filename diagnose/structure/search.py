"""Search over structures: add, exchange and drop effects until no move is significant, every rival refitted from good starts.

    current = nominal
    repeat: expand the beam; current = best by the evidence; refine, exchange, continue it
    until nothing is significant; then drop what is not

What is significant is for `diagnose.structure.significance` to say. Thresholds: docs/decisions/evidence.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import final

import numpy as np

from diagnose.evidence.context import Context
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.pool import Pool
from diagnose.progress import Progress
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import candidates
from diagnose.structure.continuation import Continuation
from diagnose.structure.growth import Growth
from diagnose.structure.moves import elsewhere, folded, formed, ground, promising, refines, with_other_laws
from diagnose.structure.multistart import Multistart
from diagnose.structure.race import Race
from diagnose.structure.reduction import Reduction
from diagnose.structure.selection import Selection
from diagnose.structure.significance import Significance
from diagnose.structure.state import State
from diagnose.structure.tempering import Tempering
from diagnose.thresholds import (
    ALIKE_C,
    BEHIND,
    BETTER_NUMBERS,
    CREEPS,
    EXPLAINS_MUCH,
    FAR,
    LACKS,
    LITTLE,
    MISFIT,
    NEARBY,
    ORDERS_FROM,
    RIVAL,
    ROUGHLY,
    UNEXPLAINED,
)

__all__ = ["ALIKE_C", "Search"]


@dataclass
class _Round:
    """Where the loop is: the incumbent, the structures to expand, those that were, and whether it stagnates."""

    current: Fitted
    beam: list[Fitted]
    expanded: set[tuple[str, ...]] = field(default_factory=set)
    stagnant: set[tuple[str, ...]] = field(default_factory=set)
    helped: bool = False
    creeps: int = 0


@final
class Search:
    """A search by a fitter's weights, composed of its moves.

    settled_by: whether the residual of a structure is noise alone; observed_by: adds to the pool what a search under an observer
    gain finds; effective_of, orders_of: effective share of the samples and spatial orders in the residual of a structure.
    """

    def __init__(
        self,
        fitter: Fitter,
        options: SearchOptions,
        progress: Progress | None = None,
        settled_by: Callable[[Fitter, Fitted], bool] | None = None,
    ) -> None:
        self.options, self.progress, self.settled_by = options, progress or Progress(), settled_by
        self.observed_by: Callable[[], None] | None = None
        self.effective_of: Callable[[Fitter, Fitted], float] | None = None
        self.orders_of: Callable[[Fitter, Fitted], tuple[tuple[float, ...], tuple[float, ...]]] | None = None
        self.context = Context(fitter, options.prices)
        self.state = State(self.context, options, self.progress)
        self.path = Continuation(self.state)
        self.significance = Significance(self.state, self.path)
        self.selection = Selection(self.state, self.significance)
        self.starts = Multistart(self.state, self.path)
        self.race = Race(self.state, self.path)
        self.growth = Growth(self.state, self.path, self.selection, self.starts, self.race)
        self.reduction = Reduction(self.state, self.path, self.significance, self.starts)
        self.tempering = Tempering(self.state, self.path)
        self.state.consider(candidates(fitter, options.only))

    @property
    def fitter(self) -> Fitter:
        """The fitter by the present weights and orders."""
        return self.context.fitter

    def use(self, fitter: Fitter) -> None:
        """Go on by another fitter of the same recordings."""
        self.context.fitter = fitter

    @property
    def pool(self) -> Pool:
        """The best fit of each structure."""
        return self.context.pool

    @property
    def tested(self) -> int:
        """Hypotheses so far."""
        return self.state.tested

    def nominal(self) -> Fitted:
        """The refitted nominal model: the rival to beat."""
        return self.starts.nominal()

    def criterion(self, f: Fitted) -> float:
        """C of a structure."""
        return self.context.criterion(f)

    def held_out(self, f: Fitted) -> HeldOut | None:
        """Held-out error of a structure."""
        return self.context.held_out(f)

    def keep(self, f: Fitted) -> None:
        """Put a fit in the pool, unless a better one of its structure is there."""
        self.pool.keep(f)

    def know(self, f: Fitted) -> None:
        """Fit a structure that was found by other weights, from there: it is a rival whatever the screen says."""
        self.keep(self.fitter.fit(self.fitter.hypothesis(f.effects, f.linear, f.own)))

    def run(self) -> Fitted:
        """The best structure that the search finds."""
        current = self.nominal()
        self._tell(current)
        if self._settled(current):
            return current
        current = self.tempering.tempered(self._shown(self.tempering.tempered(current)))
        now = _Round(current, [current])
        for turn in range(2 * self.options.depth):
            self.progress.stage("search", f"round {turn + 1}")
            self.progress.begin_round(int(len(now.current.effects) + 1 < self.options.depth))
            self._expand(now)
            best = self.selection.best(now.current)
            if best.key != now.current.key and self._settled(best):
                return self.tempering.alone(best)
            if best.key == now.current.key or not self.growth.promises(best, now.expanded):
                best = self._improved(now.current, best)
            self.progress.end_round()
            if best.key == now.current.key:
                if self._stagnates(now, best):
                    break
                continue
            self._advance(now, best)
            if self._settled(now.current):
                return self.tempering.alone(now.current)
            if now.creeps == CREEPS:
                break
            now.beam = self._beam(now.current)
        return self._pruned(self._against_other_laws(self.tempering.weigh(1.0, now.current)))

    def _expand(self, now: _Round) -> None:
        """Add an effect to each structure of the beam, until one leaves noise alone or the law of the first changes."""
        for base in now.beam:
            if base.key in now.expanded or len(base.effects) >= self.options.depth:
                continue
            now.expanded.add(base.key)
            grown = self.growth.expand(base)
            if self.state.spent() or (base.key == now.current.key and not grown):
                return  # nothing can be added to the best structure: its rivals are not built on either
            if grown and self.context.solved(base, min(grown, key=lambda f: f.chi2)):
                return
            if base is now.beam[0] and now.current.effects and self._is_incumbent(now.current):
                self.growth.refine(now.current, forms=True)  # it may be its law that is wrong, though it explains little
                if not self._is_incumbent(now.current):
                    return

    def _is_incumbent(self, current: Fitted) -> bool:
        return self.selection.best(current).key == current.key

    def _stagnates(self, now: _Round, best: Fitted) -> bool:
        """What is tried where no structure is better than the incumbent: True when nothing is left to try.

        In turn: the same effects at better numbers, the incumbent itself, larger structures whose effects are significant
        together only, a tempered prior, growing horizons, and the prior's own weight again.
        """
        if best.chi2 < BETTER_NUMBERS * now.current.chi2:
            now.current, now.beam = best, [best]
            now.expanded.discard(best.key)
            return False
        if now.current.key not in now.expanded and not self.state.spent():
            now.beam = [now.current]  # nothing that was added to its simpler form will do: to itself, then
            return False
        now.beam = [] if now.current.key in now.stagnant else self._larger(now.current, now.expanded)
        now.stagnant.add(now.current.key)
        if now.beam:
            return False
        tempered = self.fitter.prior_weight != 1.0
        if not tempered and not now.helped:  # a round with the nominal parameters' help, ahead of what is dear
            now.helped = True
            now.current = self.tempering.tempered(now.current, UNEXPLAINED)
        if tempered or self.fitter.prior_weight == 1.0:
            self._continue_multimodal(now.current)
            if not self._is_incumbent(now.current):
                return False
            if self.state.spent() or not tempered:
                return True
            now.current = self.tempering.weigh(1.0, now.current)  # with their help nothing more is found: without it, then
        now.beam = [now.current]
        now.expanded.clear()
        now.stagnant.clear()
        return False

    def _continue_multimodal(self, current: Fitted) -> None:
        """The best multimodal structures over growing horizons, unless the incumbent leaves noise alone."""
        rivals = sorted((f for f in self.pool.values() if folded(f)), key=self.criterion)[: self.options.beam]
        rivals = [] if self.context.leaves_noise(current) else [f for f in rivals if not self.path.smooths(current, f)]
        self.path.grow(rivals, current)

    def _advance(self, now: _Round, best: Fitted) -> None:
        """Go on from a better structure: by a prior, an effective share and spatial orders as its residual has them."""
        now.creeps = now.creeps + 1 if self._creeps(now.current, best) else 0
        self.state.grant_half()  # for what goes beside an effect that was dear to find
        now.current = self.tempering.tempered(best)
        if self.effective_of is not None:
            self.context.effective = self.effective_of(self.fitter, now.current)
        if self.orders_of is not None and now.current.chi2 > ORDERS_FROM * now.current.n:
            self.use(self.fitter.with_orders(*self.orders_of(self.fitter, now.current)))
        self._tell(now.current)

    def _beam(self, current: Fitted) -> list[Fitted]:
        """The structures from which the next effect is sought: the incumbent and its rivals of the same size, in simplest forms.

        Beside a structure that leaves noise alone only one that leaves hardly more can be the base of a better one.
        """
        rivals = sorted((f for f in self.pool.values() if len(f.effects) == len(current.effects)), key=self.criterion)
        passes = self.fitter.noise.within(self.fitter.misfit(current), UNEXPLAINED)
        within = BEHIND[self.context.leaves_noise(current) + passes]
        near = [f for f in rivals if f.key != current.key and f.chi2 < within * current.chi2 and not formed(f)]
        # nor is what refines the best, and gains nothing by that, another base, nor a delay at the other end
        near = [f for f in near if not (refines(f, current) and self.context.gain(current, f) < self.options.entry)]
        near = [f for f in near if not elsewhere(f, current)]
        beam = [current, *near[: self.options.beam - 1]]
        if not self.fitter.noise.absolute:
            return beam
        return list({f.key: f for f in (ground(b, self.pool) for b in beam)}.values())

    def _pruned(self, current: Fitted) -> Fitted:
        """Without what is not significant; what remains may have come to better forms beside what was dropped."""
        for _ in range(self.options.depth):
            kept = self.reduction.eliminate(current)
            if kept.key == current.key:
                return kept
            self.growth.refine(kept)
            current = self.selection.best(kept)
        return self.reduction.eliminate(current)

    def _improved(self, current: Fitted, best: Fitted) -> Fitted:
        """The best structure once the best so far was refined, exchanged, fitted over growing horizons and restarted."""
        self.growth.exchange_confounders(best)
        before = self.selection.best(current)
        best = self._under_observer(current, before)
        if self.fitter.misfit(best) > LACKS and best.chi2 < EXPLAINS_MUCH * before.chi2:
            return best  # structures under an observer gain were refined as well: what is missing beside it comes first
        self.growth.refine(best)
        refined = self.selection.best(current)
        if refined.key != best.key and math.log(best.chi2 / refined.chi2) > LITTLE:  # before it is continued by a wrong law
            self.growth.refine(refined)
        best = self._under_observer(current, self.selection.best(current))
        self.growth.exchange(best)
        best = self.selection.best(current)
        if best.key != current.key:
            best = self.tempering.tempered(best)  # ahead of growing horizons: the residual may be the price of the prior
        simple = ground(best, self.pool) if self.fitter.noise.absolute else best
        if not self.context.slow(simple):  # else, or more, once nothing can be added
            self.path.grow([simple], most=1)
        self.path.restart(self.pool.newest(best))
        return self.selection.best(self.pool.newest(current))

    def _creeps(self, poorer: Fitted, richer: Fitted) -> bool:
        """Whether an effect has entered that explains little of so much that it is no part of what is missing."""
        # without what the prior costs, which may have weighed otherwise when the poorer one was fitted
        before, after = (float(np.sum(f.fit.residual[: f.n] ** 2)) / f.n for f in (poorer, richer))
        return self.fitter.noise.exceeds(after, MISFIT) and before < after * math.exp(RIVAL)

    def _against_other_laws(self, current: Fitted) -> Fitted:
        """The best structure once those near it were tried by other laws: one may have come second by its law alone."""
        rivals = with_other_laws(self.pool, self.state.candidates, current, RIVAL)
        near = [f for f in rivals if self.context.ahead(current, f) > ALIKE_C]
        if not near or not self.fitter.noise.absolute or self.state.spent():
            return current
        for f in near[: self.options.beam]:
            self.growth.refine(f, forms=True)
        return self.selection.best(current)

    def _shown(self, current: Fitted) -> Fitted:
        """With the effects that the angle shows whatever the model is, where significant: the rest is sought beside them."""
        for candidate in [c for c in self.state.candidates if c.id in self.state.only_beside.values()]:
            entrants = self.race.look(current).screen([candidate])
            self.state.tested += len(entrants)
            for richer in self.race.run(current, [(current.effects, s) for s in entrants]):
                if self.significance.significant(current, richer):
                    current = richer
        return current

    def _settled(self, f: Fitted) -> bool:
        """Whether the residual of a structure is noise alone, so that more is sought on whitened errors only."""
        return self.settled_by is not None and self.settled_by(self.fitter, f)

    def _under_observer(self, current: Fitted, best: Fitted) -> Fitted:
        """The best structure once a nonsmooth one near it was asked, under an observer gain, what it lacks; far from the noise.

        If that is no more than other moments of its events its horizon grows. Else its free run is no base to build on: it may be
        ever so far from what the same effect does beside what is missing, and a search under an observer gain follows, once. So
        it does where the best explains little: under feedback a free run goes where no effect alone brings it back.
        """
        sticks = [f for f in self.pool.values() if f.chi2 < NEARBY * best.chi2 and self.path.sticks(f)]
        if self.observed_by is None or self.fitter.misfit(best) < LACKS or self.state.spent():
            return best
        least = min(sticks, key=self.criterion, default=None)
        if least is not None and not self.path.lacks_more(least):
            if least.key == best.key:
                return best
            self.path.grow([least])
        elif least is None and self.fitter.misfit(best) < EXPLAINS_MUCH * self.fitter.misfit(current):
            return best
        else:
            (observed_by, self.observed_by), since = (self.observed_by, None), self.fitter.runs
            observed_by()
            self.state.charge_half(since)  # what it has found is refined as well
        return self.selection.best(current)

    def _larger(self, current: Fitted, expanded: set[tuple[str, ...]]) -> list[Fitted]:
        """Structures one effect larger that gain much on the estimation data: where to go on from when none is significant."""
        if not self.fitter.noise.absolute or len(current.effects) + 1 >= self.options.depth:
            return []
        return sorted(promising(self.pool, current, expanded), key=self.criterion)[: self.options.beam]

    def polish(self, fitted: Fitted) -> Fitted:
        """The same structure fitted on to a tight tolerance; roughly, where it leaves so much that other physics is missing.

        Not at all once the budget is spent there.
        """
        if self.fitter.spent and self.fitter.above(fitted, FAR):
            return fitted
        fitted = self.path.restart(fitted)
        # a nonsmooth cost has no such minimum
        better = self.fitter.fit(
            fitted.hypothesis, fitted.fit.x, iterations=12 if fitted.rough else 40, tolerance=1e-6 if fitted.rough else 1e-8,
            slow=(self.fitter.noise.cost_at(FAR, fitted.n), ROUGHLY),
        )  # fmt: skip
        if better.ok and better.chi2 <= fitted.chi2:
            self.keep(better)
            return better
        return fitted

    def _tell(self, current: Fitted) -> None:
        """The best so far, by its error against that of the refitted nominal model."""
        if not current.key:
            self.progress.best("the nominal model, refitted")
            return
        share = 100 * math.sqrt(current.chi2 / current.n / (self.nominal().chi2 / self.nominal().n))
        self.progress.best(f"{' + '.join(current.key)} ({share:.3g} % of the refitted nominal's error)")
