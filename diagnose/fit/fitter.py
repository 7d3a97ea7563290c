"""Fit hypotheses to experiments: one weighted, if need be whitened, residual vector; equal budgets for all rivals."""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import InitVar, dataclass
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from diagnose.data.experiment import Experiment, hold_out_blocks, measured_velocity
from diagnose.data.scales import scales_by_place
from diagnose.fit.fit_cache import Memory
from diagnose.fit.fitted import UNEXPLAINED, Fitted, HeldOut
from diagnose.fit.least_squares import Fit, Linearised, Status, bounded, levenberg_marquardt
from diagnose.fit.weighted import PRIOR, Weighted
from diagnose.fit.workers import Counted, SideBySide
from diagnose.problem.hypothesis import Hypothesis
from diagnose.problem.view import MotionView, View, most_led
from mjsim.axis import Axis
from mjsim.effects import Effect, NotApplicableError, Scales
from mjsim.system import STEP, assemble

__all__ = ["Fitter"]

T = TypeVar("T")
Run = Callable[[Sequence[Callable[[], np.ndarray | None]]], list[np.ndarray | None]]

UNFOLD = (0.04, 0.06, 0.1, 0.16, 0.25, 0.4, 0.63)  # parts of a recording that a fit is unfolded over
APART = 0.15  # of the noise rms: models that come apart by more do not foretell what follows
FORETOLD = 0.05  # least part of the held-out samples by which a model that sticks or strikes may be judged
FAR = 3.0  # chi-square over n beyond which other physics is missing than a rival's last digits could tell
ROUGHLY = 2e-4  # relative gain of an iteration below which such a rival has converged
# rates [1/s] at which a model is led in turn: from a memory of 1 ms to a free run
LEADS = (1000.0, 560.0, 300.0, 170.0, 100.0, 56.0, 30.0, 17.0, 10.0, 5.6, 3.0, 1.0, 0.0)
LANDING = (300.0, 100.0, 30.0, 10.0)  # the same in few and wide steps
CLOSELY = 300.0  # rate [1/s] at which structures are compared that a free run may have left in a wrong minimum
WRONG = 2.0  # chi-square over n of a led model, at first: something else is missing than such moments; later: they are lost
LOST = 1.2  # times the least cost under a lead, or noise: an event was lost as the lead gave way, and other points are drawn
DRAWS = 3  # sets of them at most
ANEW, ANEWS, LEVELS_OFF = 5, 3, 1e-3  # iterations by secants, how often they are begun anew, and the relative gain that ends it
SHAKES, PATIENCE = 12, 3  # sets of points about a fit at most, and how many in a row may lead nowhere
SAME = 0.002  # difference in the logarithm of chi-square of one minimum: a fit that comes back to it has no better one near
SLOWLY = 0.01  # relative gain of an iteration below which a fit to all recordings, that leaves as much, has converged
RK4 = 3.5  # times as long as one product a step takes that laws make nonlinear


def _with_own(model: Axis, like: Axis) -> Axis:
    """A model with the phases of another one."""
    effects = tuple(
        a.with_values({spec.name: b.values[spec.name] for spec in a.specs() if spec.nuisance})
        for a, b in zip(model.effects, like.effects, strict=True)
    )
    return dataclasses.replace(model, effects=effects)


@dataclass
class Fitter(Weighted):
    """Everything that fits share: what they weigh, scales, threads, and what was fitted so far."""

    jobs: int = 2
    varies: tuple[str, ...] = ()
    orders: tuple[float, ...] = ()
    work: int = 0
    most_runs: float = math.inf
    memory: Memory | None = None
    beside: InitVar[Fitter | None] = None  # one that it shares threads, scales and the unit of what it takes with

    def __post_init__(self, beside: Fitter | None) -> None:
        self.threads: SideBySide = SideBySide(self.jobs) if beside is None else beside.threads
        super().__post_init__()
        self._swung: tuple[float, ...] = ()
        self._counting = threading.Lock()
        self._own: dict[tuple[object, ...], tuple[Axis, np.ndarray | None] | None] = {}
        self._pooled: dict[tuple[object, ...], tuple[float, Fitted]] = {}
        self._led: dict[tuple[object, ...], Fitted | None] = {}
        self.scales: dict[str, Scales] = self._scales() if beside is None else beside.scales
        self._steps = max(1, math.ceil(self.experiments[0].recording.dt * assemble(self.nominal).omega / STEP))
        unit = self._steps * sum(len(e.recording) for e in self.experiments)
        self.unit: int = unit if beside is None else beside.unit

    @property
    def runs(self) -> int:
        """What was simulated so far, in runs of the nominal model with friction on all estimation recordings."""
        return self.work // self.unit

    def took(self, work: int) -> None:
        """Count what was simulated, in products of a step."""
        with self._counting:
            self.work += work

    @property
    def spent(self) -> bool:
        """Whether the runs that a diagnosis may take are used up: the same on every machine, with any number of threads."""
        return self.runs > self.most_runs

    def close(self) -> None:
        """Stop the threads: what they are at comes to nothing, and is not remembered."""
        self.closed = True
        self.threads.close()

    def set_orders(self, orders: tuple[float, ...], swung: tuple[float, ...] = ()) -> None:
        """Take the spatial orders found in the residual as starts for position-locked effects; ``swung``: those of an inertia."""
        self.orders, self._swung = orders, swung
        self.scales = self._scales()

    def _scales(self) -> dict[str, Scales]:
        # judged by force, orders have to stand out of the residual: none is tried for being whole
        return scales_by_place(
            self.nominal, self.experiments[0], self.orders, self._swung, turning=self.view.channel == "velocity"
        )

    def scales_for(self, effect: type[Effect], place: str) -> Scales:
        """Scales for the starts of an effect at a place, with the orders over the angle that it follows."""
        orders = self.scales[effect.angle_of or place].orders
        return dataclasses.replace(self.scales[place], orders=orders)

    def map(self, tasks: Sequence[Callable[[], T]], lengths: Sequence[float] | None = None) -> list[T]:
        """Work side by side; answers in the order of the tasks, the longest of which is begun first."""
        return self.threads.map(tasks, lengths)

    def run(self, tasks: Sequence[Callable[[], np.ndarray | None]]) -> list[np.ndarray | None]:
        """Run residuals side by side, and count what they take."""
        counted = Counted(self.threads)
        answers = counted.run(tasks)
        self.took(counted.work)
        return answers

    def at_start(self, h: Hypothesis) -> Callable[[], np.ndarray | None]:
        """A task: the residual at the start of a hypothesis."""
        return lambda: self.residual(h)(h.start)

    def misfit(self, fitted: Fitted) -> float:
        """Chi-square over n of what a fit leaves of the recordings, without what its prior costs."""
        said = self.prior(fitted.hypothesis, fitted.fit.x)
        return (fitted.chi2 - float(said @ said)) / fitted.n

    def above(self, fitted: Fitted, level: float) -> bool:
        """Whether a fit leaves more than ``level`` times the noise variance for sure, its prior apart."""
        return self.noise.exceeds(self.misfit(fitted), level)

    def hypothesis(self, effects: Sequence[Effect], linear: Mapping[str, float] | None = None,
                   own: Mapping[tuple[str, str, int], float] | None = None) -> Hypothesis:  # fmt: skip
        """Lay out a hypothesis on these experiments."""
        moving = tuple(e.moving and self.view.channel == "velocity" for e in self.experiments)
        return Hypothesis.build(
            self.nominal, tuple(effects), self.scales, len(self.experiments), moving, linear, own, self.varies
        )

    def fit(self, h: Hypothesis, x0: np.ndarray | None = None, *, iterations: int = 25, step: float = 1e-3,
            tolerance: float = 1e-6, borrow: Fitted | None = None, secant: bool = False,
            fresh: Sequence[str] = (), rival: bool = False,
            slow: tuple[float, float] = (math.inf, 0.0)) -> Fitted:  # fmt: skip
        """Fit one hypothesis from its start.

        ``borrow``: a fitted neighbour whose sensitivities stand in for the shared parameters in the first iteration.
        ``secant``: later iterations update the Jacobian and do not difference it anew, but for the columns of the owners
        ``fresh``. ``rival``: it is fitted to be compared: while it leaves more than FAR times the noise its cost to ROUGHLY is
        enough, unless bodies stick or strike in it: a rough cost falls slowly. ``slow``: a cost, and the relative gain of an
        iteration that is enough above it.
        """
        start = h.start if x0 is None else x0
        rival = rival and self.noise.absolute and not h.rough
        how = (iterations, step, tolerance, secant, tuple(fresh), rival, slow)
        key = self._key(h, start, how, borrow) if self.memory is not None else ""
        known = self.memory.recall(key) if self.memory is not None else None
        counted = Counted(self.threads)
        coarse = (FAR * sum(int(np.sum(self.counted(e))) for e in self.experiments), ROUGHLY) if rival and not slow[1] else slow

        def solve() -> Fit:
            lent = self._borrowed(h, start, borrow, step, counted.run) if borrow is not None else None
            r0, J0 = lent if lent is not None else (None, None)
            return levenberg_marquardt(
                self.residual(h), start, h.bounds, step=np.full(len(h.entries), step), run=counted.run,
                max_iterations=iterations, tolerance=tolerance, J0=J0, r0=r0, secant=secant, reach=h.reach,
                beside=counted.beside, fresh=[i for i, e in enumerate(h.entries) if e.owner in fresh], coarse=coarse,
                slope=self.slope(h),
            )  # fmt: skip

        if known is None:
            fit = solve()
            n = max(len(fit.residual) - h.told[0], 1)
            if self.memory is not None:
                fit = dataclasses.replace(fit, linear=fit.linear.marked(key))
                if not self.closed:
                    self.memory.keep(key, fit, n, counted.work)
            work = counted.work
        else:
            # its arrays only when somebody builds on them, by the same way again
            linear = Linearised(lambda: solve().linear.arrays, key)
            fit = Fit(known.x, known.cost, linear, known.status, known.iterations, known.predicted_gain)
            n, work = known.n, known.work
        self.took(work)
        return Fitted(h, fit, n)

    def by_secants(self, h: Hypothesis, x0: np.ndarray | None = None, *, slow: tuple[float, float] = (math.inf, 0.0)) -> Fitted:
        """Fit one hypothesis by secants, begun anew every few iterations: past the steps of a rough cost, and in few runs."""
        best = self.fit(h, x0, iterations=ANEW, secant=True, slow=slow)
        for _ in range(ANEWS):
            now = self.fit(h, best.fit.x, iterations=ANEW, secant=True, slow=slow)
            best, last = (now if now.chi2 < best.chi2 else best), best
            if not best.ok or best.chi2 > last.chi2 * (1.0 - LEVELS_OFF):
                break
        return best

    def length(self, h: Hypothesis, x: np.ndarray) -> float:
        """How long a run of a hypothesis takes, over one of the nominal model with friction, as far as that is known beforehand.

        By its steps, and by how a step is taken: as one product where all is affine between events, else by RK4.
        """
        if self.view.channel != "velocity":
            return 1.0
        r = self.experiments[0].recording
        try:
            system = assemble(h.axis(x, 0))
        except (NotApplicableError, ValueError):
            return 1.0
        return max(1.0, system.mean_steps(r.dt, measured_velocity(r)) / self._steps) * (1.0 if system.affine else RK4)

    def lengths(self, fits: Sequence[Fitted]) -> list[float]:
        """How long an iteration takes from each of some fits: by its numbers and the steps of a run."""
        return [len(f.hypothesis.entries) * self.length(f.hypothesis, f.fit.x) for f in fits]

    def _key(self, h: Hypothesis, start: np.ndarray, how: tuple[object, ...], borrow: Fitted | None) -> str:
        """Hash of all that a fit depends on besides the recordings as read, the nominal model and the code."""
        from hashlib import sha256

        lent = None if borrow is None else (borrow.fit.linear.mark or borrow.fit.J.tobytes(), borrow.hypothesis.entries)
        weights = [self.sigma(e) for e in self.experiments]
        asked = (self._counting_which, h.effects, h.nominal.effects, h.entries, how, lent, weights, self.guide)
        return sha256(repr(asked).encode() + start.tobytes() + self.whitening.tobytes()).hexdigest()

    @cached_property
    def _counting_which(self) -> str:
        """Hash of the samples that count in a fit: one diagnosis may search all of its recordings in blocks once more."""
        from hashlib import sha256

        return sha256(b"|".join(np.packbits(self.counted(e)).tobytes() for e in self.experiments)).hexdigest()

    def _borrowed(
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
        count, rows, at, _ = h.told
        first = len(r) - count
        J[first:] = 0.0
        J[first + rows, at] = math.sqrt(self.guide) / PRIOR
        return r, J

    def pooled(self, fitted: Fitted) -> Fitted:
        """The same structure with its shared parameters fitted to the estimation and the held-out recordings together.

        Can it explain them all? What one leaves open (a stiffness that is not excited) another may settle, and is no missing
        physics. One that leaves much of its own cannot.
        """
        if self.above(fitted, FAR) and (self.spent or not fitted.rough):
            return fitted
        asked = (fitted.key, self.whitening.tobytes())
        known = self._pooled.get(asked)
        if known is None or abs(known[0] - fitted.chi2) >= SAME * fitted.chi2:  # else it is the same fit, polished
            known = self._pooled[asked] = fitted.chi2, self._fit_pooled(fitted)
        return known[1]

    def _fit_pooled(self, fitted: Fitted) -> Fitted:
        everything = (*self.experiments, *self.held_out)
        wider = self._beside(everything, everything, self.view)
        wider.guide = 1.0
        # one that leaves much of both need not be known to the last digit
        much = self.noise.cost_at(FAR, sum(int(np.sum(self.counted(e))) for e in everything))
        h = wider.hypothesis(fitted.effects, fitted.linear, fitted.own)
        joint = (wider.by_secants if h.rough else partial(wider.fit, iterations=15, rival=True))(h, slow=(much, SLOWLY))
        if joint.ok and joint.chi2 > UNEXPLAINED * joint.n and fitted.rough and not self.spent:
            # a free run that strikes or sticks goes astray on a recording that the parameters were not fitted to
            again = wider.unfolded(joint, fitted.linear)
            joint = again if again.ok and again.chi2 < joint.chi2 else joint
        self.took(wider.work)
        if not joint.ok:
            return fitted
        own = {k: v for k, v in joint.own.items() if k[2] < len(self.experiments)}
        h = self.hypothesis(joint.effects, joint.linear, own)
        return dataclasses.replace(fitted, hypothesis=h, fit=dataclasses.replace(fitted.fit, x=h.start))

    def in_blocks(self) -> Fitter | None:
        """A fitter that holds out every third stretch of each estimation recording; None where stretches are held out already."""
        if {id(e.recording) for e in self.experiments} & {id(e.recording) for e in self.held_out}:
            return None
        masks = [hold_out_blocks(e.recording) for e in self.experiments]
        fitted, held = (
            tuple(dataclasses.replace(e, counts=e.counts & m[part]) for e, m in zip(self.experiments, masks, strict=True))
            for part in (0, 1)
        )
        return self._beside(fitted, self.experiments, self.view, held)

    def _beside(
        self, experiments: tuple[Experiment, ...], like: Sequence[Experiment], view: View, held_out: tuple[Experiment, ...] = ()
    ) -> Fitter:
        """A fitter on the same threads for other experiments, each weighted as the one it is like, or for another view."""
        other = Fitter(
            self.nominal, view, experiments, held_out, self.jobs, self.varies, self.orders,
            whitening=self.whitening, guide=self.guide, beside=self,
        )  # fmt: skip
        other._sigma |= {id(e): self.sigma(own) for e, own in zip(experiments, like, strict=True)}
        return other

    def thinned(self, experiments: tuple[Experiment, ...], view: View, every: int) -> Fitter:
        """A fitter on every so-manyth sample: its costs, and what the nominal model says, are so many times smaller."""
        part = self._beside(experiments, self.experiments, view)
        part.guide, part.memory = self.guide / every, self.memory
        return part

    def leading(self, rate: float, held_out: tuple[Experiment, ...] = ()) -> Fitter:
        """A fitter of models that the measured velocity leads, by their own motor inertia times ``rate`` [1/s]."""
        assert isinstance(self.view, MotionView)
        view = dataclasses.replace(self.view, lead=rate)
        return self._beside(self.experiments, self.experiments, view, held_out)

    def led(
        self,
        fitted: Fitted,
        rate: float,
        iterations: int = 10,
        *,
        spread: int = 0,
        keep: int = 1,
        seed: int = 0,
        secant: bool = False,
    ) -> Fitted | None:
        """The same structure fitted to a model that the measured velocity leads, by its own inertia times ``rate`` [1/s].

        ``spread``: begun also from so many points drawn about it by its covariance, ever wider; the best ``keep`` go on. None
        where a lag of the sensor leaves no room for so high a rate. Known without a spread, it is not fitted again.
        """
        if not isinstance(self.view, MotionView) or rate > most_led(fitted.axis):
            return None
        asked = (rate, iterations, secant, fitted.key, fitted.chi2, self.guide, self.whitening.tobytes())
        if not spread and asked in self._led:
            return self._led[asked]
        part = self.leading(rate)
        h, x = fitted.hypothesis, fitted.fit.x
        starts = [x, *fitted.drawn(np.geomspace(1.0, 30.0, spread), seed)]
        answers = self.run([partial(part.residual(h), s) for s in starts])
        costs = [math.inf if r is None else float(r @ r) for r in answers]
        order = sorted(range(len(starts)), key=lambda i: costs[i])[:keep]
        chosen = order if 0 in order else [*order[:-1], 0]
        secant |= spread > 0
        fits = self.map([partial(part.fit, h, starts[i], iterations=iterations, tolerance=1e-4, secant=secant) for i in chosen])
        self.took(part.work)
        best = min((f for f in fits if f.ok), key=lambda f: f.chi2, default=None)
        if not spread:
            self._led[asked] = best
        return best

    def foretold(self, fitted: Fitted, count: int = 6, seed: int = 0) -> list[np.ndarray] | None:
        """Which held-out samples (N,), for each recording, a model foretells in spite of what it does not know of its parameters.

        Models drawn by the covariance of the fit are run beside it. Once they come apart by more than ``APART`` of the noise,
        over a tenth of a second, the free run is no prediction: bodies stick or strike at other moments, and the rest follows.
        They may come together again, but then with each other and not with the machine. None where it does not stick or strike,
        or foretells too little.
        """
        h = fitted.hypothesis
        if not fitted.rough:
            return None
        models = [h.axis(x, 0) for x in fitted.drawn(np.ones(count), seed)]
        out = []
        for experiment in self.held_out:
            solved = self.own_values(h, fitted, experiment)
            s = self.view.signals(solved[0], experiment, solved[1]) if solved is not None else None
            if s is None or solved is None:
                return None
            runs = self.map([partial(self.view.signals, _with_own(m, solved[0]), experiment, solved[1]) for m in models])
            # one that cannot be run has gone astray
            spread = [np.full(len(s.predicted), np.inf) if r is None else (r.predicted - s.predicted) ** 2 for r in runs]
            width = max(1, round(0.1 / experiment.recording.dt / self.view.decimate))
            local = np.convolve(np.mean(spread, axis=0), np.ones(width) / width, "same")
            apart = np.flatnonzero(local >= (APART * self.sigma(experiment)) ** 2)
            until = int(apart[0]) if len(apart) else len(local)
            out.append(self.counted(experiment) & (np.arange(len(local)) < until))
        share = sum(int(s.sum()) for s in out) / sum(int(np.sum(self.counted(e))) for e in self.held_out)
        return out if share >= FORETOLD else None

    def error_on(self, fitted: Fitted, samples: Sequence[np.ndarray]) -> float | None:
        """Mean square of the weighted, whitened held-out error on some samples of each recording; None without any."""
        total, count = 0.0, 0
        for experiment, chosen in zip(self.held_out, samples, strict=True):
            solved = self.own_values(fitted.hypothesis, fitted, experiment)
            e = self.error(solved[0], experiment, solved[1]) if solved is not None else None
            if e is None:
                return None
            w, keep = self.whitened(e, experiment)
            total += float(np.sum(w[keep & chosen] ** 2))
            count += int(np.sum(keep & chosen))
        return total / count if count else None

    def led_held_out(self, fitted: Fitted, rate: float) -> HeldOut | None:
        """The held-out error of a model that is led at a rate [1/s]; None if it cannot be."""
        if not isinstance(self.view, MotionView) or rate > most_led(fitted.axis):
            return None
        return self.leading(rate, self.held_out).validate(fitted)

    def led_error(self, fitted: Fitted, rate: float) -> float | None:
        """Mean square of the weighted, whitened held-out error of a led model; None if it cannot be led."""
        held = self.led_held_out(fitted, rate)
        return None if held is None else held.chi2 / float(np.sum(held.n))

    def let_go(self, fitted: Fitted, seed: int = 0, highest: float = math.inf) -> Fitted | None:
        """The same structure fitted to a led model, and on as it is led ever less, to a free run.

        Where bodies stick or strike a free run has a minimum for each order in which they do; a led model is soon put right.
        None where it cannot be led, or leaves more than noise as soon as it is: something else is missing than those moments.
        ``highest``: the rate [1/s] at which that begins.
        """
        now, least, idle = fitted, math.inf, 0
        highest = min(highest, most_led(fitted.axis))
        for k, rate in enumerate(r for r in LEADS if r <= highest):
            if self.spent:
                break
            best: Fitted | None = None
            for draw in range(DRAWS if k else 1):
                spread = 16 if k or seed or draw else 0
                at = len(LEADS) * (DRAWS * seed + draw) + k
                found = self.led(now if best is None else best, rate, 6 if k else 20, spread=spread, keep=3, seed=at)
                if found is None:
                    return None
                same = best is not None and abs(math.log(found.chi2 / best.chi2)) < SAME
                best = found if best is None or found.chi2 < best.chi2 else best
                idle = idle + 1 if same else 0 if draw else idle
                if idle >= PATIENCE or same:
                    break  # points about the best lead nowhere: no event was lost
                if best.chi2 < (LOST * max(least, best.n) if k else WRONG * best.n):
                    break
            if best is None or (not k and best.chi2 > WRONG * best.n):
                return None
            now, least = best, min(least, best.chi2)
            if now.chi2 > (LOST if rate >= CLOSELY else WRONG) * max(least, now.n):
                break  # from here it would only be drawn to another order of events; led closely it lacks something else
        return self.fit(now.hypothesis, now.fit.x, iterations=20)

    def landed(self, fitted: Fitted) -> Fitted | None:
        """The same structure fitted to a led model, and on in few steps to a free run; None where it lacks something else."""
        now = fitted
        for k, rate in enumerate(r for r in LANDING if r <= most_led(fitted.axis)):
            found = self.led(now, rate, 20, secant=k > 0)  # from one rate to the next the sensitivities hardly change
            if found is None or self.spent or (not k and found.chi2 > WRONG * found.n):
                return None
            now = found
        return self.by_secants(now.hypothesis, now.fit.x)

    def shaken(self, fitted: Fitted) -> Fitted:
        """The same structure from points drawn about its fit, as long as one of them leads to a lower minimum.

        Where bodies stick or strike the minima are many and narrow: an event a sample sooner is another one. No gradient leads
        from one to the next; points by the covariance of the fit, ever wider, do.
        """
        idle = 0
        for turn in range(SHAKES):
            if self.spent:
                break
            points = fitted.drawn(np.geomspace(0.3, 30.0, 24), turn)
            answers = self.run([partial(self.residual(fitted.hypothesis), x) for x in points])
            costs = [math.inf if r is None else float(r @ r) for r in answers]
            chosen = sorted(range(len(points)), key=lambda i: costs[i])[:2]
            begin = partial(self.fit, fitted.hypothesis, iterations=6, tolerance=1e-4, secant=True)
            fits = self.map([partial(begin, points[i]) for i in chosen if costs[i] < 2.0 * fitted.chi2])
            best = min((f for f in fits if f.ok), key=lambda f: f.chi2, default=fitted)
            idle = 0 if best.chi2 < fitted.chi2 - 1.0 else idle + 1
            fitted = best if best.chi2 < fitted.chi2 else fitted
            if idle == PATIENCE:
                break
        return fitted

    def unfolded(self, fitted: Fitted, linear: Mapping[str, float] | None, iterations: int = 12) -> Fitted:
        """The same structure fitted to the first stretch of each recording, then to ever longer ones, and then to all of it.

        A long free run has many minima: an oscillation that is off by a turn fits worse on the way to the right one than where it
        is. Over a short stretch it is not yet off by a turn.
        """
        effects, own = fitted.effects, fitted.own
        for share in UNFOLD:
            part = self._beside(tuple(e.first(share) for e in self.experiments), self.experiments, self.view)
            found = part.fit(part.hypothesis(effects, linear, own), iterations=iterations)
            self.took(part.work)
            if not found.ok or self.spent:
                return fitted
            effects, linear, own = found.effects, found.linear, found.own
        return self.fit(self.hypothesis(effects, linear, own), iterations=20)

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

    def validate(self, fitted: Fitted, samples: Sequence[np.ndarray] | None = None, blocks: int = 40) -> HeldOut | None:
        """Free-run error on the held-out experiments; phases and initial speeds are estimated anew there, nothing else is.

        ``samples``: those (N,) of each recording that count, all when None.
        """
        h = fitted.hypothesis
        sse, count, squares, total, spread = [], [], 0.0, 0, 0.0
        errors = []
        for i, experiment in enumerate(self.held_out):
            solved = self.own_values(h, fitted, experiment)
            if solved is None:
                return None
            effects_axis, initial = solved
            s = self.view.signals(effects_axis, experiment, initial)
            if s is None or not bounded(e := s.measured - s.predicted).all():
                return None
            keep = self.counted(experiment)
            w, valid = self.whitened(e, experiment)
            if samples is not None:
                keep, valid = keep & samples[i], valid & samples[i]
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
        if known not in self._own:
            self._own[known] = self._own_values(h, fitted, experiment)
        return self._own[known]

    def _own_values(self, h: Hypothesis, fitted: Fitted, experiment: Experiment) -> tuple[Axis, np.ndarray | None] | None:
        moving = experiment.moving and self.view.channel == "velocity"
        at = self.experiments.index(experiment) if experiment in self.experiments else 0
        alone = Hypothesis.build(
            h.nominal, fitted.effects, self.scales, 1, (moving,), fitted.linear,
            {(o, n, 0): v for (o, n, r), v in fitted.own.items() if r == at}, self.varies,
        )  # fmt: skip
        free = np.array([e.recording >= 0 for e in alone.entries])
        x = alone.start.copy()
        if free.any() and experiment not in self.experiments:

            def residual(z: np.ndarray) -> np.ndarray | None:
                y = x.copy()
                y[free] = z
                try:
                    return self.weighted(alone.axis(y, 0), experiment, alone.initial(y, 0))
                except ValueError:
                    return None

            lower, upper = alone.bounds
            phases = [i for i, e in enumerate(alone.entries) if e.recording >= 0 and e.name == "phase_rad"]
            start = x[free]
            if phases:  # the response turns with the phase: the basin is the quarter turn with the least error
                starts = []
                for turn in (0.0, 1.57, 3.14, -1.57):
                    y = x.copy()
                    y[phases] += turn
                    starts.append(y[free])
                costs = [math.inf if r is None else float(r @ r) for r in self.run([partial(residual, z0) for z0 in starts])]
                start = starts[int(np.argmin(costs))]
            best = levenberg_marquardt(
                residual, start, (lower[free], upper[free]), step=np.full(int(free.sum()), 1e-3), run=self.run,
                max_iterations=8, reach=alone.reach[free],
            )  # fmt: skip
            if best.status is Status.FAILED:
                return None
            x[free] = best.x
        return alone.axis(x, 0), alone.initial(x, 0)
