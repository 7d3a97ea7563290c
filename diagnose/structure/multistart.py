"""Lower minima of structures that have been fitted: a free run has many, and a fit ends in the one next to where it began.

Where bodies stick or strike there is one for each order of their events; and refitted numbers bend to what is missing, so that
what is found later begins from there.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from diagnose.fit.fitted import UNEXPLAINED, Fitted, key_of
from diagnose.fit.fitter import SAME, Fitter
from diagnose.fit.least_squares import Status
from diagnose.problem.hypothesis import Hypothesis, make
from diagnose.structure.judge import LONG, SHAKEN, Judge
from diagnose.structure.moves import at_limits, folded, simpler_at
from mjsim.effects import Effect

__all__ = ["LITTLE", "MISFIT", "NEARBY", "RIVAL", "Minima", "begun_anew", "best_begun"]

MISFIT = 3.0  # chi2 / n from which the nominal linear parameters guide the search
RIVAL = 0.1  # difference in the logarithm of chi-square of two effects that one structure could not tell apart
LITTLE = 0.02  # the same of an effect that explains next to nothing
WIDE = (1e-2, 3e-3)  # secants, in units of the scaled parameters, that smooth a rough cost
LET_GO = 3  # times at most that a led model is let go in a search
UNFOLDS = 3  # times in a row, while it gains
STARTS, ABOUT = 6, 0.25  # other starts of the nominal structure, and the spread of the logarithm of its parameters there
BETTER = 0.9  # of the nominal structure's chi-square, below which another minimum of it is one
NEARBY = 1.5  # times the chi-square of the best structure up to which one that sticks or strikes may be it
GONE = math.log(1.5)  # how far a refitted linear parameter is from the nominal one, that stands in for a body that is not there
AGAIN = 8  # starts of a structure that are fitted once more


def begun_anew(
    fitter: Fitter, f: Fitted, chosen: Sequence[Effect], linear: Sequence[Mapping[str, float] | None] | None = None
) -> Fitted:
    """The best fit of a structure from every start of the effects ``chosen``, at the parameters ``linear`` (None: nominal).

    By default beside its own and the nominal ones.
    """
    starts = []
    for effect in chosen:
        cls, rest = type(effect), tuple(e for e in f.effects if e.key != effect.key)
        own = {k: v for k, v in f.own.items() if k[0] != effect.key}
        for values in cls.starts(fitter.scales_for(cls, effect.place)):
            again = (*rest, make(cls.id, effect.place, values))
            starts += [fitter.hypothesis(again, at, own) for at in linear or (f.linear, None)]
    if not starts:
        return f
    best = best_begun(fitter, starts, AGAIN)
    on = fitter.by_secants(best.hypothesis, best.fit.x) if best.ok else best
    return on if on.ok and on.chi2 < f.chi2 else f


def best_begun(fitter: Fitter, starts: Sequence[Hypothesis], most: int, tolerance: float = 1e-3) -> Fitted:
    """The best of ``most`` starts, those of the least cost, after a few iterations by secants; not `ok` where none can be run."""
    costs = [math.inf if r is None else float(r @ r) for r in fitter.run([fitter.at_start(h) for h in starts])]
    order = sorted(range(len(starts)), key=lambda i: costs[i])[:most]
    fits = fitter.map([partial(fitter.fit, starts[i], iterations=8, tolerance=tolerance, secant=True, rival=True) for i in order])
    return min(fits, key=lambda g: g.chi2)


@dataclass
class Minima(Judge):
    """Everything fitted so far, and how to come to a lower minimum of it; within what a search may take."""

    unfolded: dict[tuple[str, ...], int] = field(default_factory=dict)  # and how often each was let go
    retried: set[tuple[tuple[str, ...], tuple[str, ...]]] = field(default_factory=set)  # what was tried by the present weight

    def __post_init__(self) -> None:
        self._began = time.monotonic()
        self._runs = self.fitter.runs
        self._let_go = 0

    def _spent(self) -> bool:
        """Whether what this stretch of the search may take (the same on every machine), or the whole diagnosis, is used up."""
        return self._left() < 0 or self._late()

    def _left(self) -> float:
        """How many simulations may still be taken."""
        return min(self.options.runs - (self.fitter.runs - self._runs), self.fitter.most_runs - self.fitter.runs)

    def _late(self) -> bool:
        """Whether what the whole diagnosis may take is used up."""
        return self.fitter.spent or time.monotonic() - self._began > self.options.seconds

    def _elsewhere(self, f: Fitted) -> Fitted:
        """The nominal structure begun about its nominal parameters as well, where it leaves much: it may have another minimum.

        An effect that only leads out of a wrong one is no missing physics.
        """
        if not f.ok or not self.fitter.above(f, MISFIT):
            return f
        rng = np.random.default_rng(0)
        nominal = {p.name: p.value for p in self.fitter.nominal.chain.linear_parameters()}
        factors = np.exp(ABOUT * rng.standard_normal((STARTS, len(nominal))))
        starts = [dict(zip(nominal, list(nominal.values()) * row, strict=True)) for row in factors]
        begin = [partial(self.fitter.fit, self.fitter.hypothesis((), s), iterations=8, rival=True) for s in starts]
        fits = [g for g in self.fitter.map(begin) if g.ok]
        best = min(fits, key=lambda g: g.chi2, default=f)
        best = self.fitter.fit(best.hypothesis, best.fit.x) if best is not f else f
        return best if best.ok and best.chi2 < BETTER * f.chi2 else f

    def _from_nominal(self, base: Fitted, grown: Sequence[Fitted], families: Sequence[str]) -> None:
        """Begin what is new in some structures at the nominal parameters, where the base's have gone far from these.

        They stand in for a further body so well that its first iterations from the nominal ones, which lead to it, are no rival.
        """
        nominal = {p.name: p.value for p in self.fitter.nominal.chain.linear_parameters()}
        ratios = [base.linear[name] / value for name, value in nominal.items() if value and name in base.linear]
        gone = any(r <= 0.0 or abs(math.log(r)) > GONE for r in ratios)
        if not gone or not self.fitter.above(base, UNEXPLAINED):
            return
        for f in grown:
            new = [e for e in f.effects if e.key not in base.key and type(e).family in families]
            if new and f.chi2 > UNEXPLAINED * f.n and not self._late():
                self.keep(begun_anew(self.fitter, f, new, (None,)))

    def _smoothed(self, f: Fitted) -> Fitted:
        """The winner of a race, once more by wide secants where its cost is rough: they see past the steps.

        A body that sticks or strikes does so a sample sooner or later as a parameter moves, and the error jumps.
        """
        rough = f.fit.status is Status.STALLED or f.rough
        if not rough or not self.fitter.noise.exceeds(f.chi2 / f.n, 1.005) or self._slow(f):
            return f
        for step in WIDE:
            wide = self.fitter.fit(f.hypothesis, f.fit.x, iterations=8, step=step, tolerance=1e-4)
            if wide.ok and wide.chi2 < f.chi2:
                f = wide
        return f

    def _land(self, running: Sequence[Fitted], base: Fitted) -> None:
        """Rivals that stick or strike, near the best, once more by way of led models; not what is first and leaves noise alone.

        A free run of theirs ends in the minimum next to where it was begun, and which of them comes first is then chance. One
        that is soon run is shaken as well. Those in which nothing does that has not landed with their base are left as they are.
        """
        if not self.fitter.noise.absolute:
            return
        new = list(running)
        if base.rough and base.chi2 < SHAKEN * base.n:
            new = [f for f in running if any(type(e).rough and e.key not in base.key for e in f.effects)]
        for f in (*new, *new):  # one that was first may not be when the others have landed
            f, best = self.pool.get(f.key, f), min((self.pool.get(g.key, g) for g in running), key=lambda g: g.chi2)
            behind = self.criterion(f) - self.criterion(best) > self.options.entry or self.fitter.misfit(f) > UNEXPLAINED
            near = f.rough and f.chi2 < NEARBY * min(best.chi2, base.chi2) and behind
            if near and not self._spent():
                self._brought_down(f)

    def _unfold(self, structures: Sequence[Fitted], beside: Fitted | None = None, most: int = UNFOLDS) -> None:
        """Structures once more over stretches of growing length, where they leave more than noise and their error is folded.

        Not those that a led model shows to lack something else, nor those that stay behind the one ``beside`` when both are led.
        ``most``: how often one may be let go.
        """
        for f in structures if self.options.free and not self._late() else ():
            known = self.unfolded.get(f.key)
            if not self.fitter.noise.exceeds(f.chi2 / f.n, UNEXPLAINED) or (known or 0) >= most or not folded(f):
                continue
            self.unfolded[f.key] = UNFOLDS
            if not self._late() and self.shake(f).chi2 < UNEXPLAINED * f.n:
                continue
            if self.lacks_more(f) or self.lacks_law(f) or (beside is not None and f.key != beside.key and self.beaten(f, beside)):
                continue
            spent = self.fitter.runs
            for linear in (f.linear, None) if known is None else ():
                for _ in range(UNFOLDS):
                    last = self.pool.get(f.key, f)
                    if self._late() or last.chi2 < UNEXPLAINED * last.n:
                        break
                    now = self.fitter.unfolded(last, linear)
                    self.keep(now)
                    if not now.ok or now.chi2 > 0.9 * last.chi2:
                        break
                    linear = now.linear
            for seed in range(known or 0, most):
                last = self.pool.get(f.key, f)
                if last.chi2 < UNEXPLAINED * last.n or not last.rough or self._late() or self.lacks_law(last):
                    break
                free = self.fitter.let_go(last, seed) if self._let_go < LET_GO else None
                if free is None:
                    break
                self._let_go += 1
                self.unfolded[f.key] = seed + 1
                self.keep(free)
                if abs(math.log(free.chi2 / last.chi2)) < SAME:
                    self.unfolded[f.key] = UNFOLDS  # it comes back to the minimum that is known
                    break
            self._runs += (self.fitter.runs - spent) // 2  # at half the cost of other structures

    def _limit(self, base: Fitted) -> list[Fitted]:
        """What the effects of a structure come to at an edge of their numbers, fitted from those numbers; the pool keeps it.

        A law of more numbers that stands there is the one of fewer, which may have ended in another minimum by itself. So may the
        law that one which is slow to run refines: stiff bristles hardly give, and all that follows would wait for their runs.
        """
        out, offered = [], {c.key for c in self.candidates}
        begin = partial(self.fitter.hypothesis, linear=base.linear, own=base.own)
        quick = [
            effects for effects in (simpler_at(base) if self._slow(base) else ())
            if self.fitter.length(h := begin(effects), h.start) <= LONG
        ]  # fmt: skip
        for effects in [*at_limits(base), *quick]:
            mark = (base.key, (*key_of(effects), repr(base.chi2)))
            if not {e.key for e in effects} - {e.key for e in base.effects} <= offered or mark in self.retried or self._late():
                continue
            self.retried.add(mark)
            *others, limit = effects
            begun = self._begun_about(tuple(others), limit, base)
            self.keep(begun)
            if begun.ok and self.criterion(begun) > self.criterion(base):  # an event a sample later is another minimum
                self._brought_down(begun)
                self._freed(self.pool.get(begun.key, begun), base)
            out.append(self.pool.get(begun.key, begun))
        return out

    def _begun_about(self, others: tuple[Effect, ...], effect: Effect, base: Fitted) -> Fitted:
        """A structure begun at the numbers of another, and of the effect at its other starts too, but for its size."""
        cls = type(effect)
        starts = cls.starts(self.fitter.scales_for(cls, effect.place)) if cls.multistart > 1 else []
        moved = [effect.with_values({k: x for k, x in v.items() if k not in cls.amplitudes}) for v in starts]
        begun = [self.fitter.hypothesis((*others, e), base.linear, base.own) for e in (effect, *moved)]
        best = best_begun(self.fitter, begun, cls.multistart)
        return self.fitter.fit(best.hypothesis, best.fit.x, iterations=20, rival=True)

    def _freed(self, f: Fitted, beside: Fitted) -> None:
        """Let go of a structure that sticks or strikes, once, which is behind one ``beside`` it in a free run alone."""
        known = self.options.free and self.fitter.noise.absolute and f.rough
        if not known or f.key in self.unfolded or self.criterion(f) <= self.criterion(beside):
            return
        within = NEARBY * NEARBY if self.fitter.misfit(beside) > UNEXPLAINED else UNEXPLAINED  # of noise alone little is missed
        if f.chi2 > within * beside.chi2 or self._let_go >= LET_GO or self._spent() or self.beaten(f, beside):
            return
        self._let_go += 1
        self.unfolded[f.key] = 1
        free = self.fitter.let_go(f)
        if free is not None:
            self.keep(free)
            self.shake(free)

    def _smooths(self, current: Fitted, f: Fitted) -> bool:
        """Whether a structure adds to one that was unfolded what explains little of what is left, or next to nothing.

        Little is enough where what is added has no folds of its own.
        """
        added = [type(e) for e in f.effects if e.key not in current.key]
        least = LITTLE if any(cls.multistart > 1 or cls.rough for cls in added) else RIVAL
        return current.key in self.unfolded and set(current.key) < set(f.key) and math.log(current.chi2 / f.chi2) < least
