"""Successive halving among neighbours of one structure: a few iterations for all, convergence for those that can win."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from diagnose.fit.fitted import Fitted
from diagnose.fit.least_squares import Status, orthonormal
from diagnose.fit.starts import multistart
from diagnose.problem.hypothesis import Hypothesis
from diagnose.structure.graph import Neighbour
from diagnose.structure.score import unexplained_squares
from diagnose.structure.screening import Screening, screening_of
from diagnose.structure.state import State
from diagnose.thresholds import FAIR, FAR, HALVINGS, LARGE, SMALL, TWICE, UNEXPLAINED
from mjsim.effects import effect_class

__all__ = ["NONLINEAR", "Halving"]

T = TypeVar("T")

NONLINEAR = ("structure", "coupling")  # families whose response is not linear in the amplitude: they move a resonance


def _adds_body(neighbour: Neighbour) -> bool:
    return effect_class(neighbour[1].candidate.id).family == NONLINEAR[0]


def _closes_loop(neighbour: Neighbour) -> bool:
    return effect_class(neighbour[1].candidate.id).closes_loop


@dataclass
class Halving:
    """Fits neighbours of a structure and records them."""

    state: State

    def __post_init__(self) -> None:
        self._last: tuple[object, Screening] | None = None

    def screening(self, base: Fitted) -> Screening:
        """The screening of the neighbours of a structure, by the present orders."""
        fitter = self.state.fitter
        asked = (base.key, base.chi2, fitter.orders, id(fitter.scales))
        if self._last is None or self._last[0] != asked:
            self._last = asked, screening_of(fitter, base)
        return self._last[1]

    def run(self, base: Fitted, neighbours: Sequence[Neighbour], floor: float) -> list[Fitted]:
        """The neighbours, fitted; ``floor``: the gain of C over the base below which one is not fitted on.

        A further feedback, a law whose runs are long, and a further body take many times what another effect does, and may take
        more than the budget. They are begun after the others, in this order, and not where another effect leaves little of the
        error: they are tried beside that one then. A body behind a gap strikes in nearly every sample: it comes after all, and
        only where the others leave more than noise.
        """
        bodies = [n for n in neighbours if _adds_body(n)]
        struck = [n for n in bodies if effect_class(n[1].candidate.id).rough]
        loops = [n for n in neighbours if _closes_loop(n)]
        others = [n for n in neighbours if n not in bodies and n not in loops]
        long = self._long(base, others)
        others = [n for n in others if n not in long]
        found = self._from_nominal(base, others, self._fitted(base, others, floor))
        for later in (loops, long, [n for n in bodies if n not in struck]):
            if found and min(f.chi2 for f in found) < SMALL * base.chi2:
                return found
            found = [*found, *self._fitted(base, later, floor, found)]
        if found and struck and not self.state.fitter.above(min(found, key=lambda f: f.chi2), UNEXPLAINED):
            return found
        return [*found, *self._fitted(base, struck, floor, found)]

    def _long(self, base: Fitted, neighbours: Sequence[Neighbour]) -> list[Neighbour]:
        """Those that take more runs than all shorter ones together, and more than their share of the runs that are left.

        A law that repeats many times over the travel has many steps in a sample.
        """
        fitter = self.state.fitter
        share = (fitter.most_runs - fitter.runs) / max(1, len(neighbours))
        iterations = sum(n for _, n, _ in HALVINGS)
        costs = []
        for others, s in neighbours:
            h = fitter.hypothesis((*others, s.effect), base.linear, base.own)
            costs.append(iterations * len(h.entries) * fitter.length(h, h.start))
        return [n for n, cost in zip(neighbours, costs, strict=True) if cost > share and cost > sum(c for c in costs if c < cost)]

    def _from_nominal(self, base: Fitted, neighbours: Sequence[Neighbour], found: list[Fitted]) -> list[Fitted]:
        """The neighbours, the leading one fitted from the nominal linear parameters as well, where it still leaves much.

        Those of the base have made up for the effects that it lacks, and may lead to another minimum than these. Where no
        neighbour of the nominal structure takes a quarter off the squared error, the leading one is that by a few iterations
        from the nominal parameters.
        """
        state, best = self.state, min(found, key=lambda f: f.chi2, default=base)
        if state.fitter.late or not state.fitter.above(best, FAR):
            return found
        start: tuple[Hypothesis, np.ndarray | None] = state.fitter.hypothesis(best.effects, None, best.own), None
        if best.chi2 > (1.0 - FAIR) * base.chi2:
            lead = None if base.effects else self._leading_at_nominal(base, neighbours)
            if lead is None or lead.chi2 >= best.chi2:
                return found
            start = lead.hypothesis, lead.fit.x
        again = state.fitter.fit(*start)
        if again.ok:
            state.keep(again)
        return [state.fits.best(f) for f in found]

    def _leading_at_nominal(self, base: Fitted, neighbours: Sequence[Neighbour]) -> Fitted | None:
        """The neighbour that leaves least after a few iterations from its best start at the nominal linear parameters."""
        state, screening = self.state, self.screening(base)
        first = state.fitter.map([partial(self._counted, partial(screening.at_nominal_start, e, s), None) for e, s in neighbours])
        few = partial(state.fitter.fit, iterations=HALVINGS[0][1])
        fits = state.fitter.map([partial(self._counted, partial(few, h), None) for h in first if h is not None])
        return min((f for f in fits if f is not None and f.ok), key=lambda f: f.chi2, default=None)

    def _fitted(self, base: Fitted, neighbours: Sequence[Neighbour], floor: float, ahead: Sequence[Fitted] = ()) -> list[Fitted]:
        """Neighbours that are fitted together, once those ``ahead`` were."""
        state = self.state
        if state.spent() or not neighbours:
            return []
        state.progress.rivals(len(neighbours))
        screening, far = self.screening(base), base.chi2 > LARGE * base.n
        screening.prepare([s.candidate.id for _, s in neighbours if far or effect_class(s.candidate.id).family in NONLINEAR])
        first = state.fitter.map([partial(self._counted, partial(screening.start, e, s, far), None) for e, s in neighbours])
        screening.count()
        running: list[Fitted] = []
        for (_, s), f in zip(neighbours, first, strict=True):
            state.failed.pop(s.candidate.key, None)
            if f is None:
                state.failed[s.candidate.key] = "the time was used up" if state.fitter.late else "no start could be run"
            else:
                running.append(f)
        for rung, halving in enumerate(HALVINGS):
            running.sort(key=lambda f: f.chi2)
            best = min((f.chi2 for f in (*ahead, *running)), default=0.0)
            self._continue(base, running, halving, floor, best, lends=rung == 0 and screening.every > 1)
        for f in running:
            state.keep(f)
        self._restart(base, running, ahead)
        return [state.fits.best(f) for f in running]

    def _continue(
        self, base: Fitted, running: list[Fitted], halving: tuple[int, int, float], floor: float, best: float, *, lends: bool
    ) -> None:
        """Further iterations of the leading fits that may still gain ``floor``, in place; ``best``: the least chi-square so far.

        ``lends``: they start with the sensitivities that they have, which are computed and not updated by secants.
        """
        (keep, iterations, behind), state, fitter = halving, self.state, self.state.fitter
        on = [
            rank for rank, f in enumerate(running[:keep])
            if f.fit.status is Status.BUDGET and math.log(f.chi2 / best) < behind
        ]  # fmt: skip
        may_win = fitter.map([partial(self.may_gain, base, running[k], floor) for k in on])
        on = [k for k, may in zip(on, may_win, strict=True) if may]
        if not on or state.spent():
            return
        state.progress.rivals(len(on))
        further = partial(fitter.fit, iterations=iterations, rival=True)
        tasks = [
            partial(self._counted, partial(
                further, f.hypothesis, f.fit.x, neighbour=f if lends and not f.rough else None
            ), f)
            for f in (running[k] for k in on)
        ]  # fmt: skip
        lengths = fitter.lengths([running[k] for k in on])
        for rank, f in zip(on, fitter.map(tasks, lengths), strict=True):
            running[rank] = f

    def _restart(self, base: Fitted, running: list[Fitted], ahead: Sequence[Fitted] = ()) -> None:
        """Fit added bodies from the nominal linear parameters, where the residual is far from the noise.

        The fitted parameters of the base compensate for the missing body, and few iterations lead from there to it. Not where a
        neighbour leaves little more than noise: no other minimum leaves much less.
        """
        fitter = self.state.fitter
        new = [
            (f, e) for f in running if fitter.above(f, FAR)
            for e in f.effects if e.key not in base.key and type(e).family == NONLINEAR[0]
        ]  # fmt: skip
        if new and fitter.noise.within(min(map(fitter.misfit, (*ahead, *running))), LARGE):
            return
        for f, effect in new:
            if not fitter.late and self.state.once("restart", f.key):
                self.state.keep(multistart(fitter, f, effect))

    def may_gain(self, base: Fitted, f: Fitted, floor: float) -> bool:
        """Whether a fit may come to gain ``floor`` in C over its base.

        Its sensitivities predict how far chi-square can fall; the bound is ``TWICE`` times that. Always where the residual of the
        base is large, since the prediction is a linear one.
        """
        if not self.state.fitter.noise.within(base.chi2 / base.n, LARGE) or not f.fit.J.any():
            return True
        left = f.chi2 - TWICE * (f.chi2 - unexplained_squares(f.fit.residual, orthonormal(f.fit.J)))
        return left <= 0.0 or self.state.context.gain(base, f) + f.n * math.log(f.chi2 / left) > floor

    def _counted(self, task: Callable[[], T], late: T) -> T:
        """The outcome of a fit, counted for the progress line; ``late`` once the budget of time is used up."""
        outcome = late if self.state.fitter.late else task()
        self.state.progress.rival()
        return outcome
