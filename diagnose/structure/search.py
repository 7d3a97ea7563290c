"""Search over structures: add, swap and drop effects until no move pays, with every rival refitted from good starts.

What pays is for `diagnose.structure.judge` to say: by the criterion, and on held-out data.
Thresholds: docs/decisions/false-alarms.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import TypeVar

import numpy as np

from diagnose.fit.fitted import UNEXPLAINED, Fitted, key_of
from diagnose.fit.fitter import FAR, ROUGHLY, SAME
from diagnose.fit.least_squares import Status, orthonormal
from diagnose.problem.hypothesis import make
from diagnose.progress import Progress
from diagnose.structure.candidates import Candidate, Screened, candidates, conflicts, left_over, related, replaced, takes_place
from diagnose.structure.judge import LACKS, LONG, SHAKEN
from diagnose.structure.moves import (
    ALIKE,
    Entrant,
    elsewhere,
    folded,
    formed,
    ground,
    imitators,
    in_place,
    other_orders,
    promising,
    refines,
    taken_apart,
    with_other_laws,
)
from diagnose.structure.multistart import LITTLE, MISFIT, NEARBY, RIVAL, best_begun
from diagnose.structure.screening import Look, look
from diagnose.structure.tempering import Guided
from mjsim.effects import Effect, effect_class

__all__ = ["ALIKE_C", "Search"]
T = TypeVar("T")

INEXACT = 0.5  # of what is left without an effect: an inexact law of it leaves no more
CREEPS = 2  # effects in a row that explain little of much, after which the library holds nothing that is missing
ASTRAY = 0.33  # of what a structure leaves: what the best addition leaves above that explains little
BEHIND = (3.0, 1.5, 1.1)  # times the chi-square of the best structure up to which its rivals are extended as well: where it
# leaves more than noise, as little but with a colour, and noise alone
HOPE = 2.0  # times the gain that a rival's sensitivities still foretell, which it is trusted with
FIRST = 6  # rivals that go on after the first look
ENTRANT, PORTION = 250, 4  # simulations that a first look at a rival may take; of how many at a time, where fewer are left
PROMISING = 0.33  # of what a structure leaves: what an effect beside it promises to leave, that is tried first
PROMISED, MORE = 0.3, 2  # of the gain in C that the screen promised, below which a rival is short of it; further starts of it
SLOW = 100  # the same of one that is slow to run, in its own runs, at least
FORMS, CRAWLS = 30, 0.01  # iterations of a simpler or poorer structure, and what each must gain while all could not bring it near
CURVED = ("structure", "coupling")  # families whose response is not linear in its amplitude: it moves a resonance
ALIKE_C = 10.0  # of C: two structures closer than a likelihood ratio of 150 are not told apart


@dataclass
class Search(Guided):
    """State of a search: everything fitted so far, by structure."""

    progress: Progress = field(default_factory=Progress)
    failed: dict[str, str] = field(default_factory=dict)
    screened: dict[tuple[str, ...], list[Screened]] = field(default_factory=dict)
    tested: int = 0
    effective_of: Callable[[Fitted], float] | None = None
    orders_of: Callable[[Fitted], tuple[tuple[float, ...], tuple[float, ...]]] | None = None
    settled_by: Callable[[Fitted], bool] | None = None  # whether what a structure leaves is noise alone
    led_by: Callable[[], None] | None = None  # adds to the pool what a search among closely led models finds
    only_beside: Mapping[str, str] = field(default_factory=dict)  # an effect that may only stand beside another, and that one

    def __post_init__(self) -> None:
        super().__post_init__()
        self.candidates = candidates(self.fitter, self.options.only)
        self._last_look: tuple[object, Look] | None = None

    def nominal(self) -> Fitted:
        """The refitted nominal model: the rival to beat."""
        if () not in self.pool:
            self.pool[()] = self._elsewhere(self.fitter.fit(self.fitter.hypothesis(())))
        return self.pool[()]

    def know(self, f: Fitted) -> None:
        """Fit a structure that was found by other weights, from there: it is a rival whatever the screen says."""
        self.keep(self.fitter.fit(self.fitter.hypothesis(f.effects, f.linear, f.own)))

    def expand(self, base: Fitted) -> list[Fitted]:
        """Fit the most promising structures with one effect more than ``base``; all are kept in the pool."""
        if self._spent():
            return []
        if base.rough and base.chi2 < SHAKEN * base.n:  # a minute error may be that of an event a sample too late
            self._limit(base)
            if self._best(base).key != base.key:
                return []  # what it comes to is built on in its place
            self._brought_down(base)
            base = self.pool.get(base.key, base)
        ranked = self._look(base).screen(self._additions(base))
        self.screened[base.key] = ranked
        self.tested += len(ranked)
        floor = self.floor(base)
        visible = self.visible(base)
        tried = [s for s in ranked if s.gain > floor][: self.options.width if visible else 4]
        # a response that is not linear in its amplitude: fitted whatever the secant says, while there is something to explain, or
        # (a structure) a filter that may have taken it in
        whatever = CURVED if visible else CURVED[:1] if len(self.fitter.whitening) > 1 else ()
        tried += [s for s in ranked if effect_class(s.candidate.id).family in whatever and s not in tried]
        if not base.effects and visible and self.fitter.above(base, MISFIT):
            keys = {s.candidate.key for s in tried}
            tried += [s for s in self._look(base).from_nominal(self._additions(base)) if s.candidate.key not in keys]
        # nor is that of another law in the place of one that the nominal axis has
        folds = [s for s in ranked if visible and effect_class(s.candidate.id).multistart > 1 and s not in tried]
        tried += [s for s in folds if replaced(base, s.candidate) is not None]
        grown = self._race(base, [(base.effects, s) for s in tried], floor)
        # led, a model has hardly any minima but one, and its parameters are not led away
        if not visible or not self.options.free or not tried or self._spent():
            return grown
        self._from_nominal(base, grown, CURVED[:1])
        grown = [self.pool.get(f.key, f) for f in grown]
        if tried[0] is not ranked[0]:
            return grown
        short = self._short_of_promise(base, tried[0])
        return grown if short is None else [short, *(f for f in grown if f.key != short.key)]

    def _additions(self, base: Fitted) -> list[Candidate]:
        """What may be added to a structure.

        Another law of an effect is tried in its place, where that leaves something material: of one that stands in the structure
        by `refine`, of one that the nominal axis has here.
        """
        material = self.fitter.above(base, UNEXPLAINED)
        return [
            c for c in self.candidates
            if not conflicts(c, base.effects) and (not effect_class(c.id).form_of or (material and replaced(base, c) is not None))
            and self._admitted([c.id, *(e.id for e in base.effects)])
        ]  # fmt: skip

    def _promises(self, best: Fitted, expanded: set[tuple[str, ...]]) -> bool:
        """Whether something promises to take up nearly all that the simplest form of a structure leaves far from the noise.

        It is tried before all that is dear: refinements, other laws, led models.
        """
        base = ground(best, self.pool)
        far = self.fitter.above(base, LACKS)
        if not far or base.key in expanded or len(base.effects) >= self.options.depth or self._spent():
            return False
        ranked = self._look(base).screen(self._additions(base))
        return bool(ranked) and base.chi2 - ranked[0].gain < PROMISING * base.chi2

    def _short_of_promise(self, base: Fitted, s: Screened) -> Fitted | None:
        """The rival that the screen has first, fitted from the nominal parameters, where it stayed far short of what it promised.

        The first iterations of a race tell little where the base's parameters have gone to stand in for it: what stiffens much is
        another spring. None where it did not stay short, or comes to no more.
        """
        cls = effect_class(s.candidate.id)
        known = self.pool.get(tuple(sorted([*base.key, s.candidate.key])))
        left = max(base.chi2 - s.gain, 0.01 * base.chi2)
        if cls.rough or known is None or self.gain(base, known) > PROMISED * base.n * math.log(base.chi2 / left):
            return None
        values = cls.starts(self.fitter.scales_for(cls, s.candidate.place))
        starts = [*(make(cls.id, s.candidate.place, v) for v in values[:MORE]), s.effect]
        begun = [self.fitter.hypothesis((*base.effects, e)) for e in starts]
        best = best_begun(self.fitter, begun, len(begun), 1e-6)
        best = self.fitter.by_secants(best.hypothesis, best.fit.x)
        if not best.ok or best.chi2 >= known.chi2:
            return None
        self.keep(best)
        return best

    def refine(self, base: Fitted, *, forms: bool = False) -> list[Fitted]:
        """Fit the structures in which an effect of ``base`` is replaced by one that refines it.

        Where the score says it can matter; by other laws (``forms``) where it leaves something material, or if asked for.
        """
        if self._spent():
            return []
        limits = self._limit(base)
        if any(self.criterion(f) < self.criterion(base) for f in limits):
            return limits  # of fewer numbers: it is gone on with
        material = (forms and self.fitter.noise.absolute) or self.fitter.above(base, UNEXPLAINED)
        grown = self._race(base, self._refinements(base, material=material))
        least = min((f.chi2 for f in grown), default=math.inf)
        if material and least > INEXACT * base.chi2:  # else the better effect is gone on with, and not the law of this one
            grown = [*grown, *self._race(base, self._other_laws(base, forms=forms), least=least)]
        if grown and self._slow(first := min(grown, key=self.criterion)):
            self._limit(first)
        return grown

    def _refinements(self, base: Fitted, *, material: bool) -> list[Entrant]:
        """What may refine an effect of a structure in its place: other effects, and itself at other orders or taken apart."""
        entrants: list[Entrant] = []
        for effect in base.effects:
            others = tuple(e for e in base.effects if e.key != effect.key)
            entrants += self._in_place_of(base, effect, others, law=False)
            mark = (base.key, (effect.key, str(self.fitter.orders)))
            if mark not in self.retried:
                self.retried.add(mark)
                entrants += other_orders(self.fitter, effect, others, material=material)
            entrants += self._new(base, taken_apart(self.fitter, self.candidates, effect, others) if material else [])
        return entrants

    def _other_laws(self, base: Fitted, *, forms: bool) -> list[Entrant]:
        """The effects of a structure by other laws, where they explain so much that only the law may be wrong, or if asked."""
        entrants: list[Entrant] = []
        for effect in base.effects:
            others = tuple(e for e in base.effects if e.key != effect.key)
            bare = self.pool.get(key_of(others))
            if forms or bare is None or base.chi2 < INEXACT * bare.chi2:
                entrants += self._in_place_of(base, effect, others, law=True)
        return entrants

    def _in_place_of(self, base: Fitted, effect: Effect, others: tuple[Effect, ...], *, law: bool) -> list[Entrant]:
        """What the screen lets take the place of an effect of a structure: effects of their own, or other laws (``law``)."""
        supposed = [
            c for c in self.candidates
            if takes_place(c, effect) and c.id != effect.id and not conflicts(c, others)
            and bool(effect_class(c.id).form_of) == law
            and related(c.id, effect) and self._admitted([c.id, *(e.id for e in others)])
            and self._untried(base, tuple(sorted([*(e.key for e in others), c.key])), c.key)
        ]  # fmt: skip
        ranked = self._look(base).screen(supposed, effect)
        self.tested += len(ranked)
        worth = 0.4 * self.options.entry
        return [(others, s) for s in ranked if s.gain > worth or effect_class(s.candidate.id).multistart > 1]

    def swap(self, base: Fitted) -> list[Fitted]:
        """Fit the structures in which an effect of ``base`` gives way to one that did as much as it beside a simpler structure.

        What has entered since may tell them apart, or it may be what kept the better one from being seen.
        """
        if not self.fitter.above(base, UNEXPLAINED) or self._spent():
            return []
        return self._race(base, self._new(base, in_place(self.pool, self.candidates, base, RIVAL)))

    def _twins(self, base: Fitted) -> None:
        """Fit the structures in which what moved as an effect of ``base`` does, beside a simpler one, takes its place."""
        if not self.fitter.above(base, UNEXPLAINED) or self._spent():
            return
        self._race(base, self._new(base, in_place(self.pool, self.candidates, base, ALIKE)))

    def _new(self, base: Fitted, entrants: Sequence[Entrant]) -> list[Entrant]:
        """Those that are admitted and were not tried from here."""
        new = [
            (others, s) for others, s in entrants
            if self._admitted([s.candidate.id, *(e.id for e in others)])
            and self._untried(base, tuple(sorted([*(e.key for e in others), s.candidate.key])), s.candidate.key)
        ]  # fmt: skip
        self.tested += len(new)
        return new

    def _admitted(self, ids: Sequence[str]) -> bool:
        """Whether every effect that may only stand beside another one does."""
        return all(name not in ids or other in ids for name, other in self.only_beside.items())

    def _untried(self, base: Fitted, key: tuple[str, ...], entrant: str) -> bool:
        """Whether a structure was not fitted yet, or from so far off that it may do better from here; once as the base is now.

        Or the effect ``entrant`` of it is locked to position at another order than the one that now stands out most.
        """
        known = self.pool.get(key)
        elsewhere = known is not None and self._at_another_order(known, entrant)
        mark = (base.key, (*key, f"{math.log(base.chi2):.1f}", str(self.fitter.orders) if elsewhere else ""))
        if known is not None and ((known.chi2 < 1.2 * base.chi2 and not elsewhere) or mark in self.retried):
            return False
        self.retried.add(mark)
        return True

    def _at_another_order(self, f: Fitted, key: str) -> bool:
        """Whether an effect of a structure is locked to position at another order than the one that now stands out most."""
        effect = next(e for e in f.effects if e.key == key)
        orders = self.fitter.scales_for(type(effect), effect.place).orders
        cycles = effect.values.get("cycles_per_rev")
        return cycles is not None and bool(orders) and abs(orders[0] - cycles) > 0.02 * cycles

    def _promising(self, base: Fitted, f: Fitted, floor: float) -> bool:
        """Whether a rival may come to gain ``floor`` in C, where its base leaves little: by what its sensitivities foretell.

        A linear model of its response knows what it can take up of what it leaves; it is trusted with ``HOPE`` times that.
        """
        if not self.fitter.noise.within(base.chi2 / base.n, 1.5) or not f.fit.J.any():
            return True
        left = f.chi2 - HOPE * (f.chi2 - left_over(f.fit.residual, orthonormal(f.fit.J)))
        return left <= 0.0 or self.gain(base, f) + f.n * math.log(f.chi2 / left) > floor

    def _race(self, base: Fitted, entrants: Sequence[Entrant], floor: float = -ALIKE_C, least: float = math.inf) -> list[Fitted]:
        """Successive halving: two iterations for all, more for those that keep up, convergence for those that can win.

        ``floor``: the gain of C over the base without which a rival is of no account. ``least``: the chi-square of the best that
        raced before.
        """
        far = base.chi2 > 1.5 * base.n
        # spread over rivals as long as there are enough of them
        entrants = self._within_reach(base, entrants)
        self.progress.rivals(len(entrants))
        spent, ground = self._spent(), self._look(base)
        if not spent:
            ground.ready([s.candidate.id for _, s in entrants if far or effect_class(s.candidate.id).family in CURVED])
        begin = [partial(self._done, partial(ground.enter, p, s, far)) for p, s in entrants]
        firsts: list[Fitted | None] = []
        portion = len(begin) if self._left() > ENTRANT * len(begin) else PORTION
        while len(firsts) < len(begin) and not spent:
            firsts += self.fitter.map(begin[len(firsts) :][:portion])
            ground.took()
            spent = self._spent()
        running: list[Fitted] = []
        for (_, s), first in zip(entrants, firsts, strict=False):
            if first is None:
                self.failed[s.candidate.key] = "no start could be run"
            else:
                running.append(first)
        # (how many go on, for how many iterations, how far behind the leader they may be, in units of n)
        for keep, iterations, behind in ((FIRST, 3, 1.5), (4, 6, 0.4), (3, 20, 0.05)):
            running.sort(key=lambda f: f.chi2)
            best = min(running[0].chi2, least) if running else 0.0
            on = [
                rank for rank, f in enumerate(running[:keep])
                if f.fit.status is Status.BUDGET and math.log(f.chi2 / best) < behind
            ]  # fmt: skip
            hopes = self.fitter.map([partial(self._promising, base, running[k], floor) for k in on])
            on = [k for k, hope in zip(on, hopes, strict=True) if hope]
            if not on or self._spent():
                continue
            self.progress.rivals(len(on))
            further = partial(self.fitter.fit, iterations=iterations, rival=True)
            # its sensitivities where it is, if they are not those that secants brought up to date
            known = [f if ground.every > 1 and keep == FIRST and not f.rough else None for f in running]
            ahead = [(running[k], known[k]) for k in on]
            longer = [
                partial(self._done, partial(further, f.hypothesis, f.fit.x, borrow=b, secant=self._slow(f))) for f, b in ahead
            ]
            lengths = self.fitter.lengths([f for f, _ in ahead])
            for rank, f in zip(on, self.fitter.map(longer, lengths), strict=True):
                running[rank] = f
        running[:1] = [self._smoothed(f) for f in running[:1]]
        for f in running:
            self.keep(f)
        self._land(running, base)
        return [self.pool.get(f.key, f) for f in running]

    def _within_reach(self, base: Fitted, entrants: Sequence[Entrant]) -> list[Entrant]:
        """Those that what may still be taken allows a first look at: a law of stiff bristles that hold takes many times as long.

        The others are listed as not fitted, until they are.
        """
        out = []
        for others, s in entrants:
            h = self.fitter.hypothesis((*others, s.effect), base.linear, base.own)
            length = self.fitter.length(h, h.start)
            if length <= LONG or SLOW * length < self._left():
                out.append((others, s))
                self.failed.pop(s.candidate.key, None)
            else:
                self.failed[s.candidate.key] = "too slow to run for what was left of the simulations (--effort allows more)"
        return out

    def _done(self, task: Callable[[], T]) -> T:
        """The outcome of a rival's fit, counted."""
        outcome = task()
        self.progress.rival()
        return outcome

    def _look(self, base: Fitted) -> Look:
        """The first look at the rivals of a structure, by the present weights and orders."""
        asked = (base.key, base.chi2, self.fitter.guide, self.fitter.orders, id(self.fitter.scales))
        if self._last_look is None or self._last_look[0] != asked:
            self._last_look = asked, look(self.fitter, base)
        return self._last_look[1]

    def _tell(self, current: Fitted) -> None:
        """The best so far, by its error against that of the refitted nominal model."""
        if not current.key:
            self.progress.best("the nominal model, refitted")
            return
        share = 100 * math.sqrt(current.chi2 / current.n / (self.nominal().chi2 / self.nominal().n))
        self.progress.best(f"{' + '.join(current.key)} ({share:.3g} % of the refitted nominal's error)")

    def run(self) -> Fitted:
        """The best structure that the search finds."""
        current = self.nominal()
        self._tell(current)
        if self._settled(current):
            return current
        current = self._guided(self._shown(self._guided(current)))
        beam = [current]
        expanded: set[tuple[str, ...]] = set()
        stuck: set[tuple[str, ...]] = set()
        helped, creeps = False, 0
        for turn in range(2 * self.options.depth):
            self.progress.stage("search", f"round {turn + 1}")
            self.progress.begin_round(int(len(current.effects) + 1 < self.options.depth))
            for state in beam:
                if state.key in expanded or len(state.effects) >= self.options.depth:
                    continue
                expanded.add(state.key)
                grown = self.expand(state)
                if self._spent() or (state.key == current.key and not grown):
                    break  # nothing can be added to the best structure: its rivals are not built on either
                if grown and self.solved(state, min(grown, key=lambda f: f.chi2)):
                    break  # nor where something that was added leaves noise alone
                if state is beam[0] and current.effects and self._best(current).key == current.key:
                    self.refine(current, forms=True)  # it may be its law that is wrong, though it explains little
                    if self._best(current).key != current.key:
                        break
            best = self._best(current)
            if best.key != current.key and self._settled(best):
                return self._alone(best)
            if best.key == current.key or not self._promises(best, expanded):
                best = self._improved(current, best)
            self.progress.end_round()
            if best.key == current.key and best.chi2 < 0.9 * current.chi2:
                current = best  # the same effects at better numbers: what can be added is another question now
                beam = [current]
                expanded.discard(current.key)
                continue
            if best.key == current.key and current.key not in expanded and not self._spent():
                beam = [current]  # nothing that was added to its simpler form will do: to itself, then
                continue
            if best.key == current.key:
                beam = [] if current.key in stuck else self._larger(current, expanded)
                stuck.add(current.key)
                if beam:
                    continue
                guided = self.fitter.guide != 1.0
                if not guided and not helped:  # a round with the nominal parameters' help, ahead of what is dear
                    helped = True
                    current = self._guided(current, UNEXPLAINED)
                if guided or self.fitter.guide == 1.0:
                    creased = sorted((f for f in self.pool.values() if folded(f)), key=self.criterion)[: self.options.beam]
                    creased = [] if self.leaves_noise(current) else [f for f in creased if not self._smooths(current, f)]
                    self._unfold(creased, current)
                    if self._best(current).key != current.key:
                        continue
                    if self._spent() or not guided:
                        break
                    current = self._weigh(1.0, current)  # with their help nothing more is found: without it, then
                beam = [current]
                expanded.clear()
                stuck.clear()
                continue
            creeps = creeps + 1 if self._creeps(current, best) else 0
            # half of the budget is left for what goes beside an effect that was dear to find
            self._runs = max(self._runs, self.fitter.runs - self.options.runs // 2)
            current = self._guided(best)
            if self.effective_of is not None:
                self.effective = self.effective_of(current)
            if self.orders_of is not None and current.chi2 > 1.02 * current.n:
                self.fitter.set_orders(*self.orders_of(current))
            self._tell(current)
            if self._settled(current):
                return self._alone(current)
            if creeps == CREEPS:
                break
            rivals = sorted((f for f in self.pool.values() if len(f.effects) == len(current.effects)), key=self.criterion)
            # beside a structure that leaves noise alone only one that leaves hardly more can be the ground of a better one
            within = BEHIND[self.leaves_noise(current) + self.fitter.noise.within(self.fitter.misfit(current), UNEXPLAINED)]
            near = [f for f in rivals if f.key != current.key and f.chi2 < within * current.chi2 and not formed(f)]
            # nor is what refines the best, and gains nothing by that, another ground, nor a delay at the other end
            near = [f for f in near if not (refines(f, current) and self.gain(current, f) < self.options.entry)]
            near = [f for f in near if not elsewhere(f, current)]
            beam = [current, *near[: self.options.beam - 1]]
            if self.fitter.noise.absolute:
                beam = list({f.key: f for f in (ground(b, self.pool) for b in beam)}.values())
        current = self._against_other_laws(self._weigh(1.0, current))
        for _ in range(self.options.depth):
            kept = self._eliminate(current)
            if kept.key == current.key:
                return kept
            # what is left may have come to a better solution beside what was dropped: its other forms are tried from there
            self.refine(kept)
            current = self._best(kept)
        return self._eliminate(current)

    def _improved(self, current: Fitted, best: Fitted) -> Fitted:
        """The best structure once the best so far was asked what it lacks, refined, put in another's place, unfolded, shaken."""
        self._twins(best)
        before = self._best(current)
        best = self._led_first(current, before)
        if self.fitter.misfit(best) > LACKS and best.chi2 < ASTRAY * before.chi2:
            return best  # led models were refined as well: what is missing beside it comes first
        self.refine(best)
        refined = self._best(current)
        if refined.key != best.key and math.log(best.chi2 / refined.chi2) > LITTLE:  # before it is unfolded by a wrong law
            self.refine(refined)
        best = self._led_first(current, self._best(current))
        self.swap(best)
        best = self._best(current)
        if best.key != current.key:
            best = self._guided(best)  # ahead of unfolding: what is left may be the price of the prior
        simple = ground(best, self.pool) if self.fitter.noise.absolute else best
        if not self._slow(simple):  # else, or more, once nothing can be added
            self._unfold([simple], most=1)
        self.shake(self.pool.get(best.key, best))
        return self._best(self.pool.get(current.key, current))

    def _creeps(self, poorer: Fitted, richer: Fitted) -> bool:
        """Whether an effect has entered that explains little of so much that it is no part of what is missing."""
        # without what the prior costs, which may have weighed otherwise when the poorer one was fitted
        before, after = (float(np.sum(f.fit.residual[: f.n] ** 2)) / f.n for f in (poorer, richer))
        return self.fitter.noise.exceeds(after, MISFIT) and before < after * math.exp(RIVAL)

    def _against_other_laws(self, current: Fitted) -> Fitted:
        """The best structure once those near it were tried by other laws: one may have come second by its law alone."""
        near = [f for f in with_other_laws(self.pool, self.candidates, current, RIVAL) if self.ahead(current, f) > ALIKE_C]
        if not near or not self.fitter.noise.absolute or self._spent():
            return current
        for f in near[: self.options.beam]:
            self.refine(f, forms=True)
        return self._best(current)

    def _shown(self, current: Fitted) -> Fitted:
        """With the effects that the angle shows whatever the model is, where they pay: the rest is sought beside them."""
        for candidate in [c for c in self.candidates if c.id in self.only_beside.values()]:
            entrants = self._look(current).screen([candidate])
            self.tested += len(entrants)
            for richer in self._race(current, [(current.effects, s) for s in entrants]):
                if self.pays(current, richer):
                    current = richer
        return current

    def _settled(self, f: Fitted) -> bool:
        """Whether what a structure leaves is noise alone, so that more is sought on whitened errors only."""
        return self.settled_by is not None and self.settled_by(f)

    def _alone(self, f: Fitted) -> Fitted:
        """A structure by its own weights, its rivals left as they are: they will be raced again, on whitened errors."""
        if self.fitter.guide == 1.0:
            return f
        for other in [k for k in self.pool if k and k != f.key]:
            del self.pool[other]
        return self._weigh(1.0, f)

    def _led_first(self, current: Fitted, best: Fitted) -> Fitted:
        """The best structure once one that sticks or strikes, and is near it, was asked what it lacks; far from the noise.

        If that is no more than other moments of its events it is unfolded. Else its free run is no ground to build on: it may be
        ever so far from what the same effect does beside what is missing, and led models are searched, once. So they are where
        the best explains little, whatever it is: under feedback a free run goes where no effect alone brings it back.
        """
        sticks = [f for f in self.pool.values() if f.chi2 < NEARBY * best.chi2 and self.sticks(f)]
        if self.led_by is None or self.fitter.misfit(best) < LACKS or self._spent():
            return best
        least = min(sticks, key=self.criterion, default=None)
        if least is not None and not self.lacks_more(least):
            if least.key == best.key:
                return best
            self._unfold([least])
        elif least is None and self.fitter.misfit(best) < ASTRAY * self.fitter.misfit(current):
            return best
        else:
            (led_by, self.led_by), spent = (self.led_by, None), self.fitter.runs
            led_by()
            self._runs += (self.fitter.runs - spent) // 2  # at half the cost: what it has found is refined as well
        return self._best(current)

    def _larger(self, current: Fitted, expanded: set[tuple[str, ...]]) -> list[Fitted]:
        """Structures one effect larger that gain much on the estimation data: where to go on from when none pays."""
        if not self.fitter.noise.absolute or len(current.effects) + 1 >= self.options.depth:
            return []
        return sorted(promising(self.pool, current, expanded), key=self.criterion)[: self.options.beam]

    def _best(self, current: Fitted) -> Fitted:
        """The structure with the best criterion among those that pay against the current one."""
        attempt = 0
        for f in sorted(self.pool.values(), key=self.criterion):
            current = self.pool.get(current.key, current)
            larger = len(f.effects) > len(current.effects) or refines(f, current)
            if self.worth_of is not None:  # held-out data judge every number that is added
                larger |= len(f.hypothesis.entries) > len(current.hypothesis.entries)
            told = self.foretold(current, f) if larger and f.key != current.key else 0.0
            if f.key == current.key or self.ahead(f, current) + told < (self.options.entry if larger else 0.5):
                continue
            attempt += larger
            if self.pays(current, f, attempt) if larger else self.earned(current, f) and not self.worse(current, f):
                return f
        return self.pool.get(current.key, current)

    def polish(self, fitted: Fitted) -> Fitted:
        """The same structure fitted on to a tight tolerance; roughly, where it leaves so much that other physics is missing.

        Not at all once the budget is spent there.
        """
        if self.fitter.spent and self.fitter.above(fitted, FAR):
            return fitted
        fitted = self.shake(fitted)
        # a rough cost has no such minimum
        better = self.fitter.fit(
            fitted.hypothesis, fitted.fit.x, iterations=12 if fitted.rough else 40, tolerance=1e-6 if fitted.rough else 1e-8,
            slow=(self.fitter.noise.cost_at(FAR, fitted.n), ROUGHLY),
        )  # fmt: skip
        if better.ok and better.chi2 <= fitted.chi2:
            self.keep(better)
            return better
        return fitted

    def without(self, current: Fitted, effect: Effect) -> Fitted:
        """The best fit of a structure without one of its effects.

        Its own, and one begun at the richer solution, both converged.
        """
        rest = tuple(e for e in current.effects if e.key != effect.key)
        known = self.pool.get(key_of(rest))
        asked = self._left_out(key_of(rest), current)
        if known is not None and asked in self._without:
            return known
        self._without.add(asked)
        h = self.fitter.hypothesis(rest, current.linear, current.own)
        if known is not None and known.fit.status is Status.CONVERGED and not rest:
            (r,) = self.fitter.run([self.fitter.at_start(h)])
            if r is None or float(r @ r) > 2.0 * known.chi2:  # else it may be a wrong minimum, which the effect has left
                return known
        slow = self._near(current) if h.rough or self._late() else (math.inf, 0.0)
        on = partial(self.fitter.fit, iterations=FORMS, rival=True, slow=slow)
        begun = on(h)
        self.keep(begun)
        if known is not None and known.fit.status is not Status.CONVERGED:
            self.keep(on(known.hypothesis, known.fit.x))
        return self.pool.get(key_of(rest), begun)

    def imitated(self, best: Fitted, effect: Effect) -> None:
        """Fit, from the best structure, what may do as much as one of its effects in its place; the pool keeps them."""
        if not self.fitter.noise.absolute:
            return
        if not self._spent():
            self._limit(best)
        # a rival that its race has left before it had converged is no further off than it has come, whatever may still be taken
        alike = [f for f in self.pool.values() if len(f.effects) == len(best.effects) and f.key != best.key]
        left = [f for f in alike if f.fit.status is Status.BUDGET and math.log(f.chi2 / best.chi2) < LITTLE]
        fits = [partial(self.fitter.fit, f.hypothesis, f.fit.x, rival=True) for f in left]
        # nor is what cannot be told from an answer left out for that: it is a part of the answer
        answers = not self._spent() or self.fitter.misfit(best) < UNEXPLAINED
        for others, s in imitators(self.fitter, best, effect, self.candidates) if answers else ():
            known = self.pool.get(tuple(sorted([*(e.key for e in others), s.candidate.key])))
            if self._admitted([s.candidate.id, *(e.id for e in others)]) and (known is None or self.ahead(best, known) > ALIKE_C):
                fits.append(
                    partial(self.fitter.fit, self.fitter.hypothesis((*others, s.effect), best.linear, best.own), rival=True)
                )
        for f in self.fitter.map(fits):
            self.keep(f)

    def _eliminate(self, current: Fitted) -> Fitted:
        """Drop every effect that does not pay; try simpler forms of each."""
        changed = True
        while changed and current.effects:
            changed = False
            fewer = self.fitter.map([partial(self.without, current, effect) for effect in current.effects])
            for effect, rest in zip(current.effects, fewer, strict=True):
                # dropped, or in the simpler form that it refines: a refinement may have entered while another effect was missing
                poorer = chain([rest], (make_it() for make_it in self._simpler(current, effect)))
                worth = (p for p in poorer if p.ok and self._admitted([e.id for e in p.effects]))
                found = next((p for p in worth if not (self.pays(p, current) or self.stands(p, current))), None)
                if found is not None:
                    current, changed = found, True
                    break
        return current

    def _near(self, current: Fitted) -> tuple[float, float]:
        """How long a poorer structure is fitted on: as long as it may still come near. The cost of what sticks falls for ever.

        Among led models it is ground to build on.
        """
        return (math.exp(FORMS * CRAWLS) * current.chi2, CRAWLS) if self.options.free else (math.inf, 0.0)

    def _simpler(self, current: Fitted, effect: Effect) -> list[Callable[[], Fitted]]:
        """Fits of a structure with each simpler form of one of its effects in place of it."""
        rest = tuple(e for e in current.effects if e.key != effect.key)

        def fit(name: str) -> Fitted:
            cls = effect_class(name)
            values = dict(cls.starts(self.fitter.scales_for(cls, effect.place))[0])
            values.update({k: v for k, v in effect.values.items() if k in values})
            h = self.fitter.hypothesis((*rest, make(name, effect.place, values)), current.linear, current.own)
            simple = self.fitter.fit(h, iterations=FORMS, rival=True, slow=self._near(current))
            self.keep(simple)
            bare = self.pool.get(key_of(rest))
            behind = simple.ok and math.log(simple.chi2 / current.chi2) > SAME
            if behind and (bare is None or simple.chi2 < bare.chi2):  # else it has come to nothing from there
                self._unfold([simple], current)  # a rival that has stalled is not beaten
            return self.pool.get(simple.key, simple)

        return [
            partial(fit, name) for name in type(effect).refines
            if effect.place in effect_class(name).places
            and not any(e.key == f"{name}@{effect.place}" for e in (*rest, *self.fitter.nominal.effects))
        ]  # fmt: skip
