"""Screening: score tests of candidates beside a structure, and the first iterations of those that are tried.

Where the residual of a structure is large, every second or third sample tells as well which candidate explains most of it
(decimation); what passes is fitted to all samples. docs/method.md.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from diagnose.data.content import decimated
from diagnose.data.experiment import Experiment
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit, Linearised, Status
from diagnose.problem.hypothesis import Hypothesis, make
from diagnose.problem.view import MotionView
from diagnose.structure.candidates import Candidate
from diagnose.structure.score import Screened, screen, span, unexplained_squares
from diagnose.thresholds import COARSE, LEAST_SAMPLES, MOST, SMALL, UNEXPLAINED
from mjsim.effects import Effect, effect_class
from mjsim.system import STEP, assemble

__all__ = ["Screening", "most_decimation", "screening_of"]


def _decimated(e: Experiment, every: int) -> Experiment:
    """Every so-manyth sample of an experiment, under the mean of the torque until the next."""
    held = e.recording.hold == "held"  # of which the mean is exact
    part = dataclasses.replace(decimated(e.recording, every, held=held), second_angle=None, second_velocity=None)
    at = slice(0, len(part) * every, every)
    correction = None if e.correction is None else e.correction[at]
    return dataclasses.replace(e, recording=part, counts=e.counts[at], correction=correction)


def _corrected(experiments: Sequence[Experiment], sigma: Sequence[float], off: np.ndarray) -> tuple[Experiment, ...]:
    """Decimated experiments, corrected by how far decimation has changed one model's weighted error (M,).

    It changes another's by nearly as much, so that their differences are those of all samples.
    """
    out, first = [], 0
    for e, s in zip(experiments, sigma, strict=True):
        correction = np.zeros(len(e.recording)) if e.correction is None else e.correction.copy()
        count = int(np.sum(e.counts))
        correction[e.counts] -= s * off[first : first + count]
        out.append(dataclasses.replace(e, correction=correction))
        first += count
    return tuple(out)


@dataclass(frozen=True)
class Screening:
    """A structure and the fitter by which its neighbours are screened.

    fitter: of every so-manyth sample (``every``) of ``whole``; full: the screening by all samples, None where this is it.
    """

    fitter: Fitter
    base: Fitted
    whole: Fitter
    every: int = 1
    full: Screening | None = None

    @cached_property
    def at_nominal(self) -> Fitted:
        """The structure at the nominal linear parameters, with its sensitivities there."""
        return self.fitter.fit(self.fitter.hypothesis(self.base.effects, None, self.base.own), iterations=1)

    def prepare(self, ids: Sequence[str]) -> None:
        """Compute `at_nominal` for these effects, so that it is computed once whatever the number of threads."""
        in_full = [name for name in ids if self.full is not None and effect_class(name).rough]
        if self.full is not None and in_full:
            self.full.prepare(in_full)
        if len(in_full) < len(ids):
            _ = self.at_nominal

    def count(self) -> None:
        """Count what was simulated on decimated samples as work of the whole."""
        if self.every > 1:
            self.whole.count_work(self.fitter.engine.counter.drain())

    def screen(self, supposed: Sequence[Candidate], replacing: Effect | None = None) -> list[Screened]:
        """`score.screen`; gains are of all samples."""
        if self.full is None:
            return screen(self.fitter, self.base, supposed, replacing)
        rough = [c for c in supposed if effect_class(c.id).rough]
        smooth = screen(self.fitter, self.base, [c for c in supposed if c not in rough], replacing)
        self.count()
        ranked = [dataclasses.replace(s, gain=self.every * s.gain) for s in smooth]
        return sorted([*ranked, *self.full.screen(rough, replacing)], key=lambda s: -s.gain)

    def start(self, others: tuple[Effect, ...], s: Screened, far: bool) -> Fitted | None:
        """A few iterations from the best starts of an effect beside ``others``; None where none can be run.

        Starts are ranked by their cost less what the linear parameters take up. Beside the fitted linear parameters the nominal
        ones are tried: for a coupling or a further body, whose response is not linear in the amplitude, and where the residual is
        ``far`` from the noise. An effect that closes a loop is fitted to the end.
        """
        cls = effect_class(s.candidate.id)
        if cls.rough and self.full is not None:  # its minima depend on the times of single events
            return self.full.start(others, s, far)
        multimodal, stiff = cls.multistart > 1, cls.family in ("structure", "coupling")
        guesses, fitted = self._starts(others, s, far=far)
        residuals = self.fitter.run([self.fitter.at_start(h) for h in guesses])
        spans = (span(self.base), span(self.at_nominal) if fitted < len(guesses) else None)
        cost = [unexplained_squares(r, spans[i >= fitted]) for i, r in enumerate(residuals)]
        order = sorted(range(len(guesses)), key=lambda i: cost[i])
        if stiff:  # a start of no amplitude costs no more than the base: both kinds of starts go on
            half = (cls.multistart + 1) // 2
            order = [i for i in order if i < fitted][:half] + [i for i in order if i >= fitted][:half]
        else:
            order = order[: cls.multistart]
        if far and fitted < len(guesses) and max(order) < fitted:
            order.append(min(range(fitted, len(guesses)), key=lambda i: cost[i]))
        fresh = (s.candidate.key,) if multimodal else ()  # the columns that change most
        lent = self.at_nominal if fitted < len(guesses) and not (cls.rough or self.base.rough) else None
        order = [i for i in order if math.isfinite(cost[i])]
        if cls.closes_loop:  # updates by secants stall where all numbers move
            fits = self.fitter.map([partial(self.fitter.fit, guesses[i]) for i in order])
            best = min((f for f in fits if f.ok), key=lambda f: f.chi2, default=None)
            return None if best is None else self._in_full(best)
        begin = partial(self.fitter.fit, iterations=3, tolerance=1e-4, secant=True, fresh=fresh)
        fits = self.fitter.map([
            partial(begin, guesses[i], neighbour=self.base if i < fitted else lent) for i in order
        ])  # fmt: skip
        first = min((f for f in fits if f.ok), key=lambda f: f.chi2, default=None)
        if first is None:
            return None
        if multimodal and first.fit.status is Status.BUDGET:
            first = self.fitter.fit(
                first.hypothesis, first.fit.x, iterations=6, tolerance=0.02, neighbour=first, secant=True, fresh=fresh
            )  # fmt: skip
        return self._in_full(first.unconverged())

    def at_nominal_start(self, others: tuple[Effect, ...], s: Screened) -> Hypothesis | None:
        """The start of an effect at the nominal linear parameters that costs least; None where none can be run."""
        guesses, fitted = self._starts(others, s, far=True)
        at_nominal = guesses[fitted:]
        residuals = self.fitter.run([self.fitter.at_start(h) for h in at_nominal])
        cost = [math.inf if r is None else float(r @ r) for r in residuals]
        best = min(range(len(cost)), key=cost.__getitem__, default=None)
        return None if best is None or math.isinf(cost[best]) else at_nominal[best]

    def _starts(self, others: tuple[Effect, ...], s: Screened, *, far: bool) -> tuple[list[Hypothesis], int]:
        """Starts of an effect, and how many of them, the first, are at the fitted linear parameters; the rest at the nominal."""
        cls, fitter, base = effect_class(s.candidate.id), self.fitter, self.base
        own = {k: v for k, v in base.own.items() if k[0] != s.candidate.key}  # an effect that enters again has phases of its own
        guesses = [fitter.hypothesis((*others, e), base.linear, own) for e in s.starts[: None if cls.multistart > 1 else 2]]
        declared = [make(cls.id, s.candidate.place, v) for v in cls.starts(fitter.scales_for(cls, s.candidate.place))]
        stiff = cls.family in ("structure", "coupling")
        at_nominal = declared if stiff else [*s.starts[:2], *declared[:2]] if far else []
        return guesses + [fitter.hypothesis((*others, e), None, own) for e in at_nominal], len(guesses)

    def _in_full(self, f: Fitted) -> Fitted | None:
        """A fit by all samples; its sensitivities are computed when they are asked for. None where it cannot be run."""
        if self.every == 1:
            return f
        h, x = f.hypothesis, f.fit.x
        (r,) = self.whole.run([partial(self.whole.residual(h), x)])
        if r is None:
            return None

        def linear() -> tuple[np.ndarray, np.ndarray]:
            _, J = self.whole.linearised(h, x, 1e-3, self.whole.run)
            return r, np.zeros((len(r), len(x))) if J is None else J

        fit = Fit(x, float(r @ r), Linearised(linear), Status.BUDGET, f.fit.iterations, f.fit.predicted_gain)
        return Fitted(h, fit, max(len(r) - h.prior_terms[0], 1))


def _rows(fitter: Fitter, every: int) -> np.ndarray:
    """Which of the samples that count (M,) decimation keeps."""
    rows, first = [], 0
    for e in fitter.experiments:
        keep = fitter.counted(e)
        position = first + np.cumsum(keep) - 1
        at = np.arange(0, len(keep) // every * every, every)
        rows.append(position[at[keep[at]]])
        first += int(np.sum(keep))
    return np.concatenate(rows)


def _on_rows(base: Fitted, rows: np.ndarray, every: int) -> Fitted:
    """A fit on some rows of its residual, with its prior scaled to them."""
    r, J = base.fit.linear.arrays
    first = len(r) - base.hypothesis.prior_terms[0]
    rest = 1.0 / math.sqrt(every)
    r, J = np.concatenate([r[rows], rest * r[first:]]), np.concatenate([J[rows], rest * J[first:]])
    fit = dataclasses.replace(base.fit, cost=float(r @ r), linear=Linearised.known(r, np.asfortranarray(J)))
    return Fitted(base.hypothesis, fit, len(rows))


def most_decimation(fitter: Fitter, base: Fitted) -> int:
    """Of how many samples one may do where the neighbours of a fitted structure are screened; 1: all are needed."""
    view = fitter.view
    if (
        not isinstance(view, MotionView)
        or len(fitter.whitening) > 1
        or fitter.misfit(base) < UNEXPLAINED
        or any(e.recording.velocity is None or e.recording.command is not None for e in fitter.experiments)
        or not base.fit.J.any()
    ):
        return 1
    fastest = max(e.recording.dt for e in fitter.experiments) * assemble(fitter.nominal).omega
    samples = sum(int(np.sum(fitter.counted(e))) for e in fitter.experiments)
    return max(1, min(int(COARSE / max(fastest, STEP / 10)), samples // LEAST_SAMPLES))


def screening_of(fitter: Fitter, base: Fitted) -> Screening:
    """The screening of the neighbours of a fitted structure, by as few samples as give the same answer."""
    view = fitter.view
    for every in range(most_decimation(fitter, base), 1, -1):
        assert isinstance(view, MotionView)
        coarse = dataclasses.replace(view, step=COARSE)
        experiments = tuple(_decimated(e, every) for e in fitter.experiments)
        part = fitter.related(fitter.problem.decimated(experiments, coarse, every), remembers=True)
        seen = _on_rows(base, _rows(fitter, every), every)
        (r,) = part.run([partial(part.residual(base.hypothesis), base.fit.x)])
        fitter.count_work(part.work)
        if r is None or len(r) != len(seen.fit.residual):
            continue
        off = r - seen.fit.residual
        if float(off @ off) < (SMALL if base.rough and view.observer_gain == 0 else MOST) * (seen.chi2 - seen.n):
            same = _corrected(experiments, [fitter.sigma(e) for e in fitter.experiments], off)
            thin = fitter.related(fitter.problem.decimated(same, coarse, every), remembers=True)
            return Screening(thin, seen, fitter, every, Screening(fitter, base, fitter))
    return Screening(fitter, base, fitter)
