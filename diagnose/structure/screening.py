"""The first look at rivals of a structure: which promise most, and where each is to begin.

Most of a search goes into looking at what is then left aside. Where a structure leaves much, every second or third sample tells
as well which rival takes up most of that; what goes on is fitted to all of them. docs/method.md.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from diagnose.data.experiment import Experiment
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit, Linearised, Status
from diagnose.problem.hypothesis import Hypothesis, make
from diagnose.problem.view import MotionView
from diagnose.structure.candidates import Candidate, Screened, left_over, screen, span
from diagnose.thresholds import BESIDE_NOMINAL, COARSE, FAITHFUL, LEAST_SAMPLES, LEAVES
from mjsim.effects import Effect, effect_class
from mjsim.system import STEP, assemble

__all__ = ["Look", "look"]


def _thin(e: Experiment, every: int) -> Experiment:
    """Every so-manyth sample of an experiment, under the mean of the torque until the next."""
    r = e.recording
    n = len(r) // every
    at = slice(0, n * every, every)
    thin = dataclasses.replace(
        r, time=r.time[at], dt=every * r.dt, torque=r.torque[: n * every].reshape(n, every).mean(axis=1),
        velocity=None if r.velocity is None else r.velocity[at], angle=None if r.angle is None else r.angle[at],
        second_angle=None, second_velocity=None, columns={},
    )  # fmt: skip
    return dataclasses.replace(e, recording=thin, counts=e.counts[at])


def _corrected(experiments: Sequence[Experiment], sigma: Sequence[float], off: np.ndarray) -> tuple[Experiment, ...]:
    """Thin experiments, compared less what holding the torque's mean has changed in one model's error (M,).

    It changes another's by nearly as much, so that their differences are those of all samples.
    """
    out, first = [], 0
    for e, s in zip(experiments, sigma, strict=True):
        correction = np.zeros(len(e.recording))
        count = int(np.sum(e.counts))
        correction[e.counts] = -s * off[first : first + count]
        out.append(dataclasses.replace(e, correction=correction))
        first += count
    return tuple(out)


@dataclass(frozen=True)
class Look:
    """A structure, and the fitter that looks at its rivals by every so-manyth sample of ``whole``; ``full``: by all of them."""

    fitter: Fitter
    base: Fitted
    whole: Fitter
    every: int = 1
    full: Look | None = None
    apart: set[str] = field(default_factory=set)  # rivals that promise much beside the nominal parameters

    @cached_property
    def begun(self) -> Fitted:
        """The structure at the nominal linear parameters, with its sensitivities there."""
        return self.fitter.fit(self.fitter.hypothesis(self.base.effects, None, self.base.own), iterations=1)

    def ready(self, ids: Sequence[str]) -> None:
        """Have `begun` fitted for rivals of these effects: once, whatever the number of threads that will ask for it."""
        in_full = [name for name in ids if self.full is not None and effect_class(name).rough]
        if self.full is not None and in_full:
            self.full.ready(in_full)
        if len(in_full) < len(ids):
            _ = self.begun

    def took(self) -> None:
        """Have what was simulated so far counted."""
        if self.every > 1:
            self.whole.took(self.fitter.engine.counter.drain())

    def screen(self, supposed: Sequence[Candidate], replacing: Effect | None = None) -> list[Screened]:
        """`candidates.screen`; gains are of all samples."""
        if self.full is None:
            return screen(self.fitter, self.base, supposed, replacing)
        rough = [c for c in supposed if effect_class(c.id).rough]
        smooth = screen(self.fitter, self.base, [c for c in supposed if c not in rough], replacing)
        self.took()
        ranked = [dataclasses.replace(s, gain=self.every * s.gain) for s in smooth]
        return sorted([*ranked, *self.full.screen(rough, replacing)], key=lambda s: -s.gain)

    def from_nominal(self, supposed: Sequence[Candidate]) -> list[Screened]:
        """The few candidates that promise most beside the nominal parameters: refitted ones may have gone where none does."""
        ranked = screen(self.fitter, self.begun, supposed)[:BESIDE_NOMINAL]
        self.took()
        self.apart.update(s.candidate.key for s in ranked)
        return ranked

    def enter(self, present: tuple[Effect, ...], s: Screened, far: bool) -> Fitted | None:
        """A few cheap iterations from the best starts of one rival; None when none of them can be run."""
        # the response of these is not linear in their amplitude, and a stiffness has drifted to stand in for them: they begin
        # from the nominal parameters as well, with amplitudes that no secant has moved
        fitter, base = self.fitter, self.base
        cls = effect_class(s.candidate.id)
        if cls.rough and self.full is not None:  # which minimum it comes to, hangs on the moments at which it sticks or strikes
            return self.full.enter(present, s, far)
        curved = cls.multistart > 1
        stiff = cls.family in ("structure", "coupling")
        own = (s.candidate.key,) if curved else ()  # the columns that change most
        # where the same effect enters once more, its own phases are those of its starts
        rest = {k: v for k, v in base.own.items() if k[0] != s.candidate.key}
        guesses = [fitter.hypothesis((*present, e), base.linear, rest) for e in s.starts[: None if curved else 2]]
        borrowing = len(guesses)
        raw = [make(cls.id, s.candidate.place, v) for v in cls.starts(fitter.scales_for(cls, s.candidate.place))]
        from_nominal = (*raw,) if stiff else (*s.starts[:2], *raw[:2]) if far else ()
        guesses += [fitter.hypothesis((*present, e), None, rest) for e in from_nominal]
        residuals = fitter.run([fitter.at_start(h) for h in guesses])
        # what the base's own parameters, or the nominal ones, will take up does not count against a start
        spans = (span(base), span(self.begun) if from_nominal else None)
        cost = [left_over(r, spans[i >= borrowing]) for i, r in enumerate(residuals)]
        order = sorted(range(len(guesses)), key=lambda i: cost[i])
        if stiff:  # one that the screen has shrunk to nothing costs no more than the base: both kinds go on
            half = (cls.multistart + 1) // 2
            order = [i for i in order if i < borrowing][:half] + [i for i in order if i >= borrowing][:half]
        else:
            order = order[: cls.multistart]
        if far and borrowing < len(guesses) and max(order) < borrowing:
            # far off, the refitted parameters may have gone where no way leads back from
            order.append(min(range(borrowing, len(guesses)), key=lambda i: cost[i]))
        # how a body that sticks or strikes answers to the others' parameters, they do not know without it
        lent = self.begun if from_nominal and not (cls.rough or base.rough) else None
        borrows = [base if i < borrowing else lent for i in order]
        begin = partial(fitter.fit, iterations=3, tolerance=1e-4, secant=True, fresh=own)
        tasks = [partial(begin, guesses[i], borrow=b) for i, b in zip(order, borrows, strict=True) if math.isfinite(cost[i])]
        fits = fitter.map(tasks)
        if s.candidate.key in self.apart and not (curved or cls.rough):
            fits += self._on_from_nominal(fits, [guesses[i] for i in order if i >= borrowing])
        first = min((f for f in fits if f.ok), key=lambda f: f.chi2, default=None)
        if first is None:
            return None
        if curved and first.fit.status is Status.BUDGET:
            # on a curved way it is early to say how far it leads: on while it falls fast
            first = fitter.fit(first.hypothesis, first.fit.x, iterations=6, tolerance=0.02, borrow=first, secant=True, fresh=own)
        # what ended by so loose a tolerance, or on a Jacobian brought up to date by secants, has not converged
        return self._in_full(first.to_go_on())

    def _on_from_nominal(self, fits: Sequence[Fitted], begun: Sequence[Hypothesis]) -> list[Fitted]:
        """The best of the fits that were begun at the nominal parameters, on by sensitivities of its own, where it is behind.

        Refitted parameters stand in for what is missing, and no way may lead from there to what is; borrowed sensitivities lead
        nowhere from afar. ``begun``: those hypotheses.
        """
        ahead = min((f.chi2 for f in fits if f.ok), default=math.inf)
        mine = min((f for f in fits if f.ok and any(f.hypothesis is h for h in begun)), key=lambda f: f.chi2, default=None)
        if mine is None or mine.chi2 <= ahead:
            return []
        return [self.fitter.fit(mine.hypothesis, mine.fit.x, iterations=4, tolerance=1e-3)]

    def _in_full(self, f: Fitted) -> Fitted | None:
        """A fit by this look, by all samples; its sensitivities are had when they are asked for. None where it cannot be run."""
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
        return Fitted(h, fit, max(len(r) - h.told[0], 1))


def _rows(fitter: Fitter, every: int) -> np.ndarray:
    """Which of the samples that count (M,) a look at every so-manyth has."""
    rows, first = [], 0
    for e in fitter.experiments:
        keep = fitter.counted(e)
        position = first + np.cumsum(keep) - 1
        at = np.arange(0, len(keep) // every * every, every)
        rows.append(position[at[keep[at]]])
        first += int(np.sum(keep))
    return np.concatenate(rows)


def _seen(base: Fitted, rows: np.ndarray, every: int) -> Fitted:
    """A fit as a look at some rows of its residual sees it."""
    r, J = base.fit.linear.arrays
    count = base.hypothesis.told[0]
    first = len(r) - count
    rest = 1.0 / math.sqrt(every)
    r, J = np.concatenate([r[rows], rest * r[first:]]), np.concatenate([J[rows], rest * J[first:]])
    fit = dataclasses.replace(base.fit, cost=float(r @ r), linear=Linearised.known(r, np.asfortranarray(J)))
    return Fitted(base.hypothesis, fit, len(rows))


def look(fitter: Fitter, base: Fitted) -> Look:
    """How to look at the rivals of a fitted structure: by as few samples as tell, for what it leaves, what all would."""
    view = fitter.view
    if (
        not isinstance(view, MotionView)
        or len(fitter.whitening) > 1
        or fitter.misfit(base) < LEAVES
        or any(e.recording.velocity is None or e.recording.command is not None for e in fitter.experiments)
        or not base.fit.J.any()
    ):
        return Look(fitter, base, fitter)
    fastest = max(e.recording.dt for e in fitter.experiments) * assemble(fitter.nominal).omega
    samples = sum(int(np.sum(fitter.counted(e))) for e in fitter.experiments)
    most = min(int(COARSE / max(fastest, STEP / 10)), samples // LEAST_SAMPLES)
    for every in range(most, 1, -1):
        coarse = dataclasses.replace(view, step=COARSE)
        experiments = tuple(_thin(e, every) for e in fitter.experiments)
        part = fitter.beside(fitter.problem.thinned(experiments, coarse, every), remembers=True)
        seen = _seen(base, _rows(fitter, every), every)
        (r,) = part.run([partial(part.residual(base.hypothesis), base.fit.x)])
        fitter.took(part.work)
        if r is None or len(r) != len(seen.fit.residual):
            continue
        off = r - seen.fit.residual
        if float(off @ off) < FAITHFUL[base.rough and view.lead == 0] * (seen.chi2 - seen.n):
            same = _corrected(experiments, [fitter.sigma(e) for e in fitter.experiments], off)
            thin = fitter.beside(fitter.problem.thinned(same, coarse, every), remembers=True)
            return Look(thin, seen, fitter, every, Look(fitter, base, fitter))
    return Look(fitter, base, fitter)
