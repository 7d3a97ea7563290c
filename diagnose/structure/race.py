"""Successive halving among the rivals of one structure: a few iterations for all, convergence for those that can win."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from diagnose.fit.fitted import Fitted
from diagnose.fit.least_squares import Status, orthonormal
from diagnose.structure.candidates import left_over
from diagnose.structure.continuation import Continuation
from diagnose.structure.moves import Entrant
from diagnose.structure.screening import Look, look
from diagnose.structure.state import State
from diagnose.thresholds import ALIKE_C, ENTRANT, FIRST, HALVINGS, HOPE, LEAVES_MUCH, LONG, PORTION, SLOW_RUNS
from mjsim.effects import effect_class

__all__ = ["CURVED", "Race"]

T = TypeVar("T")

CURVED = ("structure", "coupling")  # families whose response is not linear in its amplitude: it moves a resonance


@dataclass
class Race:
    """Fits rivals of a structure; the pool keeps them."""

    state: State
    path: Continuation

    def __post_init__(self) -> None:
        self._last: tuple[object, Look] | None = None

    def look(self, base: Fitted) -> Look:
        """The first look at the rivals of a structure, by the present weights and orders."""
        fitter = self.state.fitter
        asked = (base.key, base.chi2, fitter.prior_weight, fitter.orders, id(fitter.scales))
        if self._last is None or self._last[0] != asked:
            self._last = asked, look(fitter, base)
        return self._last[1]

    def run(self, base: Fitted, entrants: Sequence[Entrant], floor: float = -ALIKE_C, least: float = math.inf) -> list[Fitted]:
        """The rivals, fitted; ``floor``: the gain of C over the base without which a rival is of no account.

        ``least``: the chi-square of the best that raced before.
        """
        state = self.state
        entrants = self._within_reach(base, entrants)
        state.progress.rivals(len(entrants))
        spent, ground = state.spent(), self.look(base)
        running: list[Fitted] = []
        for (_, s), first in zip(entrants, [] if spent else self._first_looks(base, ground, entrants), strict=False):
            if first is None:
                state.failed[s.candidate.key] = "no start could be run"
            else:
                running.append(first)
        for halving in HALVINGS:
            running.sort(key=lambda f: f.chi2)
            self._go_on(base, ground, running, halving, floor, least)
        running[:1] = [self.path.smoothed(f) for f in running[:1]]
        for f in running:
            state.keep(f)
        self.path.land_near(running, base)
        return [state.pool.newest(f) for f in running]

    def _first_looks(self, base: Fitted, ground: Look, entrants: Sequence[Entrant]) -> list[Fitted | None]:
        """A few iterations of each; in portions, where little is left, until nothing is."""
        state, far, spent = self.state, base.chi2 > LEAVES_MUCH * base.n, False
        ground.ready([s.candidate.id for _, s in entrants if far or effect_class(s.candidate.id).family in CURVED])
        begin = [partial(self._counted, partial(ground.enter, p, s, far)) for p, s in entrants]
        firsts: list[Fitted | None] = []
        portion = len(begin) if state.left() > ENTRANT * len(begin) else PORTION
        while len(firsts) < len(begin) and not spent:
            firsts += state.fitter.map(begin[len(firsts) :][:portion])
            ground.took()
            spent = state.spent()
        return firsts

    def _go_on(
        self, base: Fitted, ground: Look, running: list[Fitted], halving: tuple[int, int, float], floor: float, least: float
    ) -> None:
        """Further iterations of those that keep up and may come to gain, in place."""
        (keep, iterations, behind), state, fitter = halving, self.state, self.state.fitter
        best = min(running[0].chi2, least) if running else 0.0
        on = [
            rank for rank, f in enumerate(running[:keep])
            if f.fit.status is Status.BUDGET and math.log(f.chi2 / best) < behind
        ]  # fmt: skip
        hopes = fitter.map([partial(self.promising, base, running[k], floor) for k in on])
        on = [k for k, hope in zip(on, hopes, strict=True) if hope]
        if not on or state.spent():
            return
        state.progress.rivals(len(on))
        further = partial(fitter.fit, iterations=iterations, rival=True)
        # its sensitivities where it is, if they are not those that secants brought up to date
        known = [f if ground.every > 1 and keep == FIRST and not f.rough else None for f in running]
        ahead = [(running[k], known[k]) for k in on]
        longer = [
            partial(self._counted, partial(further, f.hypothesis, f.fit.x, borrow=b, secant=state.context.slow(f)))
            for f, b in ahead
        ]
        lengths = fitter.lengths([f for f, _ in ahead])
        for rank, f in zip(on, fitter.map(longer, lengths), strict=True):
            running[rank] = f

    def promising(self, base: Fitted, f: Fitted, floor: float) -> bool:
        """Whether a rival may come to gain ``floor`` in C, where its base leaves little: by what its sensitivities predict.

        A linear model of its response knows what it can take up of its residual; it is trusted with ``HOPE`` times that.
        """
        if not self.state.fitter.noise.within(base.chi2 / base.n, LEAVES_MUCH) or not f.fit.J.any():
            return True
        left = f.chi2 - HOPE * (f.chi2 - left_over(f.fit.residual, orthonormal(f.fit.J)))
        return left <= 0.0 or self.state.context.gain(base, f) + f.n * math.log(f.chi2 / left) > floor

    def _within_reach(self, base: Fitted, entrants: Sequence[Entrant]) -> list[Entrant]:
        """Those that what may still be taken allows a first look at: a law of stiff bristles that hold takes many times as long.

        The others are listed as not fitted, until they are.
        """
        out, state = [], self.state
        for others, s in entrants:
            h = state.fitter.hypothesis((*others, s.effect), base.linear, base.own)
            length = state.fitter.length(h, h.start)
            if length <= LONG or SLOW_RUNS * length < state.left():
                out.append((others, s))
                state.failed.pop(s.candidate.key, None)
            else:
                state.failed[s.candidate.key] = "too slow to run for what was left of the simulations (--effort allows more)"
        return out

    def _counted(self, task: Callable[[], T]) -> T:
        """The outcome of a rival's fit, counted."""
        outcome = task()
        self.state.progress.rival()
        return outcome
