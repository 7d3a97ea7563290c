"""Fit hypotheses to a problem: one weighted, if need be whitened, residual vector; equal budgets for all rivals."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TypeVar, final

import numpy as np

from diagnose.data.experiment import Experiment, measured_velocity
from diagnose.fit.engine import Engine
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.least_squares import Fit, Linearised, levenberg_marquardt, residual_and_jacobian
from diagnose.fit.ledger import Ledger
from diagnose.fit.nuisance import nuisance_values
from diagnose.fit.workers import Counted, WorkerPool
from diagnose.problem.hypothesis import Hypothesis
from diagnose.problem.noise_model import NoiseModel
from diagnose.problem.problem import Problem, Residual, bounded
from diagnose.problem.view import View
from diagnose.thresholds import ANEW, FAR, ONE_FIT, SAME, SMALL
from mjsim.axis import Axis
from mjsim.effects import Effect, NotApplicableError, Scales
from mjsim.system import assemble

__all__ = ["Fitter"]

T = TypeVar("T")
Run = Callable[[Sequence[Callable[[], np.ndarray | None]]], list[np.ndarray | None]]


@final
class Fitter:
    """Fits hypotheses to a problem on an engine; `relax` and `on` give fitters of other problems."""

    def __init__(
        self,
        nominal: Axis,
        view: View,
        experiments: tuple[Experiment, ...],
        held_out: tuple[Experiment, ...],
        jobs: int = 2,
        varies: tuple[str, ...] = (),
        ledger: Ledger | None = None,
    ) -> None:
        self.problem = Problem.of(nominal, view, experiments, held_out, varies)
        unit = self.problem.steps * sum(len(e.recording) for e in experiments)
        self.engine = Engine(WorkerPool(jobs), unit, ledger)

    @classmethod
    def of(cls, problem: Problem, engine: Engine) -> Fitter:
        """Of a problem, on an engine."""
        fitter = cls.__new__(cls)
        fitter.problem, fitter.engine = problem, engine
        return fitter

    def relax(self, *, whitening: np.ndarray | None = None, prior_weight: float | None = None) -> Fitter:
        """On the same engine, by another whitening filter or weight of the prior."""
        return Fitter.of(self.problem.relax(whitening=whitening, prior_weight=prior_weight), self.engine)

    def paced_by(self, axis: Axis) -> Fitter:
        """On the same engine, whose runs are counted by the steps of an axis: a nominal servo may be far too stiff."""
        problem = dataclasses.replace(self.problem, pace=axis)
        self.engine.unit = problem.steps * sum(len(e.recording) for e in self.experiments)
        return Fitter.of(problem, self.engine)

    def related(self, problem: Problem, *, remembers: bool = False, counts_here: bool = False) -> Fitter:
        """A fitter of a related problem on the same threads; see `Engine.related`."""
        return Fitter.of(problem, self.engine.related(remembers=remembers, counts_here=counts_here))

    def with_orders(self, orders: tuple[float, ...], swung: tuple[float, ...] = (), unsure: tuple[float, ...] = ()) -> Fitter:
        """On the same engine, with spatial orders as starts; ``swung``: of a varying inertia; ``unsure``: with more to show."""
        return Fitter.of(self.problem.with_orders(orders, swung, unsure), self.engine)

    @property
    def nominal(self) -> Axis:
        """The nominal axis."""
        return self.problem.nominal

    @property
    def view(self) -> View:
        """How a model is judged."""
        return self.problem.view

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """The recordings that are fitted."""
        return self.problem.experiments

    @property
    def held_out(self) -> tuple[Experiment, ...]:
        """The recordings that are held out."""
        return self.problem.held_out

    @property
    def varies(self) -> tuple[str, ...]:
        """Linear parameters that each recording has of its own."""
        return self.problem.varies

    @property
    def orders(self) -> tuple[float, ...]:
        """Spatial orders in the residual."""
        return self.problem.orders

    @property
    def scales(self) -> Mapping[str, Scales]:
        """Scales by place."""
        return self.problem.scales

    @property
    def whitening(self) -> np.ndarray:
        """The whitening filter."""
        return self.problem.whitening

    @property
    def prior_weight(self) -> float:
        """The weight of the nominal model's numbers."""
        return self.problem.prior_weight

    @property
    def noise(self) -> NoiseModel:
        """What is known of the noise."""
        return self.problem.noise

    @property
    def work(self) -> int:
        """What was simulated so far, in products of a step."""
        return self.engine.counter.work

    @property
    def runs(self) -> int:
        """What was simulated so far, in runs of the nominal model with friction on all estimation recordings."""
        return self.engine.runs

    @property
    def most_runs(self) -> float:
        """How many runs may be taken."""
        return self.engine.most_runs

    @property
    def spent(self) -> bool:
        """Whether the runs that may be taken, or the time, are used up."""
        return self.engine.spent

    @property
    def late(self) -> bool:
        """Whether the budget of time is used up."""
        return self.engine.late

    def allow(self, runs: float, until: float | None = None) -> None:
        """Set how many runs may be taken, and by which time of the monotonic clock [s] the search ends (None: as it is)."""
        self.engine.most_runs = runs
        self.engine.until = self.engine.until if until is None else until

    def count_work(self, work: int) -> None:
        """Count what was simulated, in products of a step."""
        self.engine.counter.add(work)

    def close(self) -> None:
        """Stop the threads: what they are at comes to nothing, and is not remembered."""
        self.engine.close()

    def sigma(self, experiment: Experiment) -> float:
        """Noise rms used as weight."""
        return self.problem.sigma(experiment)

    def counted(self, experiment: Experiment) -> np.ndarray:
        """Mask of the compared samples that count."""
        return self.problem.counted(experiment)

    def error(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray | None:
        """Measured minus predicted at every compared sample, in the view's unit."""
        return self.problem.error(axis, experiment, initial)

    def whitened(self, e: np.ndarray, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
        """Weighted, whitened error (M,) and which of it counts."""
        return self.problem.whitened(e, experiment)

    def hypothesis(self, effects: Sequence[Effect], linear: Mapping[str, float] | None = None,
                   own: Mapping[tuple[str, str, int], float] | None = None) -> Hypothesis:  # fmt: skip
        """Lay out a hypothesis on these recordings."""
        return self.problem.hypothesis(effects, linear, own)

    def scales_for(self, effect: type[Effect], place: str) -> Scales:
        """Scales for the starts of an effect at a place."""
        return self.problem.scales_for(effect, place)

    def error_of(self, fitted: Fitted, i: int) -> np.ndarray | None:
        """The error of a fitted model on estimation recording i."""
        h, x = fitted.hypothesis, fitted.fit.x
        return self.error(h.axis(x, i), self.experiments[i], h.initial(x, i))

    def residual(self, h: Hypothesis) -> Residual:
        """Residual vector as a function of the scaled vector; None once the fitter is closed."""
        residual = self.problem.residual(h)
        return lambda x: None if self.engine.closed else residual(x)

    def at_start(self, h: Hypothesis) -> Callable[[], np.ndarray | None]:
        """A task: the residual at the start of a hypothesis."""
        return lambda: self.residual(h)(h.start)

    def linearised(
        self, h: Hypothesis, x: np.ndarray, step: float, run: Run, which: Sequence[int] | None = None
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Residual (N,) and Jacobian (N, p) at a scaled vector by secants of ``step``, or those of its columns ``which``."""
        slope = self.problem.slope(h)
        residual = self.residual(h) if slope is None else slope(x)
        return residual_and_jacobian(residual, x, np.full(len(x), step), *h.bounds, run, which)

    def map(self, tasks: Sequence[Callable[[], T]], lengths: Sequence[float] | None = None) -> list[T]:
        """Run tasks on the worker pool; answers in the order of the tasks, the longest of which starts first."""
        return self.engine.threads.map(tasks, lengths)

    def run(self, tasks: Sequence[Callable[[], np.ndarray | None]]) -> list[np.ndarray | None]:
        """Run residuals side by side, and count what they take."""
        counted = Counted(self.engine.threads)
        answers = counted.run(tasks)
        self.count_work(counted.work)
        return answers

    def misfit(self, fitted: Fitted) -> float:
        """Chi-square over n of the residual of a fit, without what its prior costs."""
        said = self.problem.prior(fitted.hypothesis, fitted.fit.x)
        return (fitted.chi2 - float(said @ said)) / fitted.n

    def above(self, fitted: Fitted, level: float) -> bool:
        """Whether a fit leaves more than ``level`` times the noise variance for sure, its prior apart."""
        return self.noise.exceeds(self.misfit(fitted), level)

    def fit(self, h: Hypothesis, x0: np.ndarray | None = None, *, iterations: int = 25, step: float = 1e-3,
            tolerance: float = 1e-6, neighbour: Fitted | None = None, secant: bool = False,
            fresh: Sequence[str] = (), rival: bool = False,
            slow: tuple[float, float] = (math.inf, 0.0)) -> Fitted:  # fmt: skip
        """Fit one hypothesis from its start.

        ``neighbour``: a fitted structure whose sensitivities are used for the shared parameters in the first iteration.
        ``secant``: later iterations update the Jacobian and do not difference it anew, but for the columns of the owners
        ``fresh``. ``rival``: it is fitted to be compared: while it leaves more than FAR times the noise, a small part of SAME is
        enough, unless bodies stick or strike in it: a rough cost falls slowly. ``slow``: a cost, and the relative gain of an
        iteration that is enough above it.
        """
        start = h.start if x0 is None else x0
        rival = rival and self.noise.absolute and not h.rough
        how = (iterations, step, tolerance, secant, tuple(fresh), rival, slow)
        key = self._key(h, start, how, neighbour) if self.engine.ledger is not None else ""
        known = self.engine.ledger.recall(key) if self.engine.ledger is not None else None
        counted = Counted(self.engine.threads)
        coarse = (
            (FAR * sum(int(np.sum(self.counted(e))) for e in self.experiments), SMALL * SAME) if rival and not slow[1] else slow
        )

        def solve() -> Fit:
            lent = self._from_neighbour(h, start, neighbour, step, counted.run) if neighbour is not None else None
            r0, J0 = lent if lent is not None else (None, None)
            return levenberg_marquardt(
                self.residual(h), start, h.bounds, step=np.full(len(h.entries), step), run=counted.run,
                max_iterations=iterations, tolerance=tolerance, J0=J0, r0=r0, secant=secant, reach=h.reach,
                fresh=[i for i, e in enumerate(h.entries) if e.owner in fresh], coarse=coarse,
                slope=self.problem.slope(h), spent=lambda: counted.work > ONE_FIT * self.most_runs * self.engine.unit,
            )  # fmt: skip

        if known is None:
            fit = solve()
            n = max(len(fit.residual) - h.prior_terms[0], 1)
            if self.engine.ledger is not None:
                fit = dataclasses.replace(fit, linear=fit.linear.marked(key))
                if not self.engine.closed:
                    self.engine.ledger.keep(key, fit, n, counted.work)
            work = counted.work
        else:
            # its arrays only when somebody builds on them, by the same way again
            linear = Linearised(lambda: solve().linear.arrays, key)
            fit = Fit(known.x, known.cost, linear, known.status, known.iterations, known.predicted_gain)
            n, work = known.n, known.work
        self.count_work(work)
        return Fitted(h, fit, n)

    def by_secants(self, h: Hypothesis, x0: np.ndarray | None = None, *, slow: tuple[float, float] = (math.inf, 0.0)) -> Fitted:
        """Fit one hypothesis by secants, with a new Jacobian every few iterations: for a nonsmooth cost, in few runs."""
        best = self.fit(h, x0, iterations=ANEW, secant=True, slow=slow)
        for _ in range(ANEW):
            now = self.fit(h, best.fit.x, iterations=ANEW, secant=True, slow=slow)
            best, last = (now if now.chi2 < best.chi2 else best), best
            if not best.ok or best.chi2 > last.chi2 * (1.0 - SAME):
                break
        return best

    def length(self, h: Hypothesis, x: np.ndarray) -> float:
        """How long a run of a hypothesis takes, over one of the nominal model with friction, as far as that is known beforehand.

        By its steps, and by how a step is taken: as one product where all is affine between events, else by RK4.
        """
        if self.view.channel == "torque":
            return 1.0
        r = self.experiments[0].recording
        try:
            system = assemble(h.axis(x, 0))
        except (NotApplicableError, ValueError):
            return 1.0
        return max(1.0, system.mean_steps(r.dt, measured_velocity(r)) / self.problem.steps) * (1.0 if system.affine else 4.0)

    def lengths(self, fits: Sequence[Fitted]) -> list[float]:
        """How long an iteration takes from each of some fits: by its numbers and the steps of a run."""
        return [len(f.hypothesis.entries) * self.length(f.hypothesis, f.fit.x) for f in fits]

    def _key(self, h: Hypothesis, start: np.ndarray, how: tuple[object, ...], neighbour: Fitted | None) -> str:
        """Hash of all that a fit depends on besides the recordings as read, the nominal model and the code."""
        from hashlib import sha256

        lent = (
            None if neighbour is None else (neighbour.fit.linear.mark or neighbour.fit.J.tobytes(), neighbour.hypothesis.entries)
        )
        weights = [self.sigma(e) for e in self.experiments]
        which = (self._counting_which, self.view)
        asked = (*which, h.effects, h.nominal.effects, h.entries, how, lent, weights, self.problem.prior_weight)
        return sha256(repr(asked).encode() + start.tobytes() + self.whitening.tobytes()).hexdigest()

    @cached_property
    def _counting_which(self) -> str:
        """Hash of the samples that count in a fit: one diagnosis may search all of its recordings in blocks once more."""
        from hashlib import sha256

        return sha256(b"|".join(np.packbits(self.counted(e)).tobytes() for e in self.experiments)).hexdigest()

    def _from_neighbour(
        self, h: Hypothesis, x: np.ndarray, base: Fitted, step: float, run: Run
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Residual and Jacobian at x, the columns for the parameters of ``base`` taken from there; None where it lends none."""
        if not base.fit.J.any():
            return None
        x = np.clip(x, *h.bounds)
        known = {e.label: (e.scale, base.fit.J[:, i]) for i, e in enumerate(base.hypothesis.entries)}
        own = [i for i, e in enumerate(h.entries) if e.label not in known]
        r, part = self.linearised(h, x, step, run, own)
        if r is None or part is None or len(r) != base.fit.J.shape[0]:
            return None
        J = np.empty((len(r), len(x)), order="F")
        J[:, own] = part
        for i, e in enumerate(h.entries):
            if e.label in known:
                scale, column = known[e.label]
                J[:, i] = column if e.log else column * (e.scale / scale)
        # what the nominal model says is known exactly, and may weigh otherwise by now
        rows, at, slope = self.problem.prior_slope(h)
        first = len(r) - h.prior_terms[0]
        J[first:] = 0.0
        J[first + rows, at] = slope
        return r, J

    def refined(self, fitted: Fitted, step: float = 2e-4) -> Fitted:
        """The same fit with a two-sided Jacobian at its solution, for covariances."""
        h, f = fitted.hypothesis, fitted.fit
        r, forward = self.linearised(h, f.x, step, self.run)
        assert r is not None
        _, backward = self.linearised(h, f.x, -step, self.run)
        if forward is None or backward is None:
            return fitted
        J = 0.5 * (forward + backward)
        return Fitted(h, Fit(f.x, f.cost, Linearised.known(r, J), f.status, f.iterations, f.predicted_gain), fitted.n)

    def validate(self, fitted: Fitted, blocks: int = 40) -> HeldOut | None:
        """Free-run error on the held-out experiments; phases and initial speeds are estimated anew there, nothing else is."""
        h = fitted.hypothesis
        sse, count, squares, total, spread = [], [], 0.0, 0, 0.0
        errors = []
        for experiment in self.held_out:
            solved = self.own_values(h, fitted, experiment)
            if solved is None:
                return None
            effects_axis, initial = solved
            s = self.view.signals(effects_axis, experiment, initial)
            if s is None or not bounded(e := s.measured - s.predicted).all():
                return None
            keep = self.counted(experiment)
            w, valid = self.whitened(e, experiment)
            w2 = w**2
            errors.append(w[valid])
            for part in np.array_split(np.flatnonzero(valid), blocks):
                sse.append(float(np.sum(w2[part])))
                count.append(len(part))
            squares += float(np.sum(e[keep] ** 2))
            total += int(np.sum(keep))
            m = s.measured[keep]
            spread += float(np.sum((m - m.mean()) ** 2))
        return HeldOut(
            np.concatenate(errors), np.array(sse), np.array(count), math.sqrt(squares / total), math.sqrt(squares / spread)
        )  # fmt: skip

    def own_values(self, h: Hypothesis, fitted: Fitted, experiment: Experiment) -> tuple[Axis, np.ndarray | None] | None:
        """The fitted axis with this experiment's own phases and initial speed, estimated on it; remembered."""
        known = (fitted.key, h.nominal.effects, fitted.fit.x.tobytes(), self.whitening.tobytes(), id(experiment))
        if known not in self.engine.own:
            self.engine.own[known] = nuisance_values(self.problem, self.run, fitted, experiment)
        solved: tuple[Axis, np.ndarray | None] | None = self.engine.own[known]
        return solved
