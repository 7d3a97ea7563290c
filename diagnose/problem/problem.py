"""What is fitted to what: recordings, how a model of them is judged, and how its errors are weighed.

The residual of a hypothesis is, over all estimation recordings,

    r(x) = A (y - y_model(x)) / sigma        and        sqrt(w) (x - x_nominal) / PRIOR

with A the whitening filter, sigma the noise rms of a recording and w the weight of the prior. Of a motion without a drive the
mean angle is compared as well: the rates do not have it, and it tells where the torques that bring the axis back vanish.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import numpy as np

from diagnose.data.experiment import Experiment
from diagnose.data.scales import scales_by_place
from diagnose.problem.hypothesis import Hypothesis
from diagnose.problem.noise_model import KnownNoise, ModelError, NoiseModel
from diagnose.problem.start_state import Begin
from diagnose.problem.view import MotionView, View
from diagnose.thresholds import TWICE
from mjsim.axis import Axis
from mjsim.effects import Effect, Scales
from mjsim.signals import lfilter, weigh_into
from mjsim.system import STEP, assemble, restoring

__all__ = ["Problem", "Residual", "bounded"]


Residual = Callable[[np.ndarray], np.ndarray | None]
"""A residual vector (N,) of a scaled vector (p,); None where the model cannot be run."""


def bounded(values: np.ndarray | float) -> np.ndarray:
    """Where values are numbers whose squares are: an axis that its fitted numbers make unstable swings up without end."""
    return np.asarray(np.abs(values) < 1e100)


@final
@dataclass(frozen=True, eq=False)
class Problem:
    """Recordings, view and weights; `relax` and `on` return other problems.

    varies: linear parameters that each recording has of its own; orders, swung: spatial orders in the residual, as starts for
    position-locked effects and for a varying inertia; unsure: those of the orders that do not stand out over all; whitening:
    monic filter over a scale; prior_weight: of the nominal model's numbers; sigmas: noise rms by recording; pace: the axis by
    whose steps runs are counted, the nominal one if None.
    """

    nominal: Axis
    view: View
    experiments: tuple[Experiment, ...]
    held_out: tuple[Experiment, ...]
    scales: Mapping[str, Scales]
    sigmas: Mapping[int, float]
    varies: tuple[str, ...] = ()
    orders: tuple[float, ...] = ()
    swung: tuple[float, ...] = ()
    unsure: tuple[float, ...] = ()
    whitening: np.ndarray = field(default_factory=lambda: np.ones(1))
    prior_weight: float = 1.0
    pace: Axis | None = None
    _clear: dict[int, np.ndarray] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(
        cls,
        nominal: Axis,
        view: View,
        experiments: tuple[Experiment, ...],
        held_out: tuple[Experiment, ...],
        varies: tuple[str, ...] = (),
    ) -> Problem:
        """A problem with white errors and the prior's own weight."""
        bare = cls(nominal, view, experiments, held_out, {}, {}, varies)
        sigmas = {id(e): view.noise(e) or bare._weight_of_unknown_noise(e) for e in (*experiments, *held_out)}
        return dataclasses.replace(bare, sigmas=sigmas).with_orders((), ())

    def relax(self, *, whitening: np.ndarray | None = None, prior_weight: float | None = None) -> Problem:
        """The same by another whitening filter or weight of the prior."""
        return dataclasses.replace(
            self,
            whitening=self.whitening if whitening is None else whitening,
            prior_weight=self.prior_weight if prior_weight is None else prior_weight,
        )

    def with_orders(self, orders: tuple[float, ...], swung: tuple[float, ...] = (), unsure: tuple[float, ...] = ()) -> Problem:
        """The same with the spatial orders found in a residual as starts."""
        # judged by force, orders have to stand out of the residual: none is tried for being whole
        turning = self.view.channel != "torque"
        scales = scales_by_place(self.nominal, self.experiments[0], orders, swung, turning=turning)
        return dataclasses.replace(self, scales=scales, orders=orders, swung=swung, unsure=unsure)

    def on(
        self,
        experiments: tuple[Experiment, ...],
        like: Sequence[Experiment],
        view: View | None = None,
        held_out: tuple[Experiment, ...] = (),
    ) -> Problem:
        """The same on other recordings, each weighted as the one it is ``like``, or by another view."""
        view = view or self.view
        sigmas = {id(e): self.sigma(own) for e, own in zip(experiments, like, strict=True)}
        for e in held_out:
            if id(e) not in sigmas:
                sigmas[id(e)] = view.noise(e) or self._weight_of_unknown_noise(e)
        return dataclasses.replace(self, view=view, experiments=experiments, held_out=held_out, sigmas=sigmas)

    def under_observer(self, gain: float, held_out: tuple[Experiment, ...] = ()) -> Problem:
        """The same under an observer gain [1/s]: the measured velocity corrects the model, by its own inertia times the gain."""
        assert isinstance(self.view, MotionView)
        return self.on(self.experiments, self.experiments, dataclasses.replace(self.view, observer_gain=gain), held_out)

    def tied(self) -> Problem:
        """The same with gravity and springs at the recorded angle."""
        assert isinstance(self.view, MotionView)
        return self.on(self.experiments, self.experiments, dataclasses.replace(self.view, tied=True), self.held_out)

    @property
    def holds(self) -> bool:
        """Whether gravity or a spring of the nominal model holds the axis near an angle that is recorded, in a free run."""
        free = isinstance(self.view, MotionView) and self.view.channel == "velocity"
        recorded = all(e.recording.angle is not None for e in (*self.experiments, *self.held_out))
        return free and recorded and bool(restoring(self.nominal).any())

    def decimated(self, experiments: tuple[Experiment, ...], view: View, every: int) -> Problem:
        """On every so-manyth sample: costs, and what the nominal model says, are so many times smaller."""
        return self.on(experiments, self.experiments, view).relax(prior_weight=self.prior_weight / every)

    def _weight_of_unknown_noise(self, experiment: Experiment) -> float:
        """A tenth of the nominal model's error: a weight where the noise is not known beforehand."""
        e = self.error(self.nominal, experiment, None)
        if e is None:
            return 1.0
        return 0.1 * float(np.sqrt(np.mean(e[self.counted(experiment)] ** 2)))

    @cached_property
    def noise(self) -> NoiseModel:
        """What is known of the noise."""
        return KnownNoise() if all(self.view.noise(e) is not None for e in self.experiments) else ModelError()

    @cached_property
    def steps(self) -> int:
        """Steps a sample of the axis by which runs are counted."""
        axis = self.nominal if self.pace is None else self.pace
        return max(1, math.ceil(self.experiments[0].recording.dt * assemble(axis).omega / STEP))

    def sigma(self, experiment: Experiment) -> float:
        """Noise rms used as weight."""
        return self.sigmas[id(experiment)]

    def counted(self, experiment: Experiment) -> np.ndarray:
        """Mask of the compared samples that count."""
        return self.view.counts(experiment)

    def scales_for(self, effect: type[Effect], place: str) -> Scales:
        """Scales for the starts of an effect at a place, with the orders over the angle that it follows."""
        orders = self.scales[effect.angle_of or place].orders
        return dataclasses.replace(self.scales[place], orders=orders)

    def hypothesis(self, effects: Sequence[Effect], linear: Mapping[str, float] | None = None,
                   own: Mapping[tuple[str, str, int], float] | None = None) -> Hypothesis:  # fmt: skip
        """Lay out a hypothesis on these recordings."""
        begins = tuple(self.begin(e) for e in self.experiments)
        return Hypothesis.build(
            self.nominal, tuple(effects), self.scales, len(self.experiments), begins, linear, own, self.varies
        )

    def begin(self, experiment: Experiment) -> Begin:
        """What is free of the state in which a recording starts; nothing where the model is moved as recorded.

        From rest the first measured angle is taken as it is: a servo, or friction, holds it.
        """
        moving = experiment.moving and self.view.channel != "torque"
        return Begin(moving, experiment.speed, experiment.angle_error) if moving else Begin(False)

    def error(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray | None:
        """Measured minus predicted at every compared sample, in the view's unit."""
        s = self.view.signals(axis, experiment, initial)
        if s is None:
            return None
        e = s.measured - s.predicted
        return e if bounded(e).all() else None

    def weighted(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray | None:
        """The error whitened, weighted and cut to the samples that count."""
        out = np.empty(len(self.counted(experiment)) + 1)
        count = self._weigh(axis, experiment, initial, out)
        return None if count is None else out[:count]

    def _weigh(
        self, axis: Axis, experiment: Experiment, initial: np.ndarray | None, out: np.ndarray, rounding: np.ndarray | None = None
    ) -> int | None:
        """Write `weighted` from the start of ``out`` on; how many numbers that are, None where it cannot be had.

        ``rounding``: that of the prediction, in place of its own.
        """
        s = self.view.signals(axis, experiment, initial)
        if s is None:
            return None
        held = rounding is not None and s.rounding is not None
        predicted = s.predicted - s.rounding + rounding if held else s.predicted
        how = self.counted(experiment), self.whitening, self._counted_whitened(experiment)
        count = int(weigh_into(s.measured, predicted, self.sigma(experiment), *how, out))
        if count < 0:
            return None
        if experiment.recording.driven:
            return count
        out[count] = s.mean_angle
        return count + 1 if bounded(s.mean_angle) else None

    def whitened(self, e: np.ndarray, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
        """Weighted, whitened error (M,) and which of it counts: not the samples that the filter reaches past a gap."""
        w = e / self.sigma(experiment)
        if len(self.whitening) > 1:
            w = lfilter(self.whitening, [1.0], np.where(self.counted(experiment), w, 0.0))
        return w, self._counted_whitened(experiment)

    def _counted_whitened(self, experiment: Experiment) -> np.ndarray:
        """Which of the whitened errors count: not those that the filter reaches past a gap."""
        keep, p = self.counted(experiment), len(self.whitening) - 1
        if p == 0:
            return keep
        if id(experiment) not in self._clear:
            reach = np.convolve(~keep, np.ones(p + 1))[: len(keep)] > 0
            reach[:p] = True
            self._clear[id(experiment)] = keep & ~reach
        return self._clear[id(experiment)]

    def residual(self, h: Hypothesis, roundings: Sequence[np.ndarray | None] = ()) -> Residual:
        """Residual vector over all estimation recordings as a function of the scaled vector.

        ``roundings``: those of their predictions, in place of their own.
        """

        def of(x: np.ndarray) -> np.ndarray | None:
            out = np.empty(sum(len(self.counted(e)) + 1 for e in self.experiments) + h.prior_terms[0])
            at = 0
            for r, experiment in enumerate(self.experiments):
                try:
                    axis = h.axis(x, r)
                except ValueError:
                    return None
                count = self._weigh(axis, experiment, h.initial(x, r), out[at:], roundings[r] if roundings else None)
                if count is None:
                    return None
                at += count
            out[at : at + h.prior_terms[0]] = self.prior(h, x)
            return out[: at + h.prior_terms[0]]

        return of

    def slope(self, h: Hypothesis) -> Callable[[np.ndarray], Residual] | None:
        """Where a sensor reports in steps: of a point, the residual whose secants tell how the model moves with its numbers.

        Those of the rounded model tell which of its samples a small step rounds the other way: a few by chance, that lead
        anywhere. The rounding is held as it is at the point, but for numbers of its own. None where nothing is rounded.
        """
        own = h.rounding
        if not own:
            return None
        residual = self.residual(h)

        def at(point: np.ndarray) -> Residual:
            smooth = self.residual(h, [self._rounding(h, point, r) for r in range(len(self.experiments))])
            return lambda x: (smooth if np.array_equal(x[own], point[own]) else residual)(x)

        return at

    def _rounding(self, h: Hypothesis, x: np.ndarray, r: int) -> np.ndarray | None:
        """The rounding of a prediction of recording r."""
        try:
            s = self.view.signals(h.axis(x, r), self.experiments[r], h.initial(x, r))
        except ValueError:
            return None
        return None if s is None else s.rounding

    def prior(self, h: Hypothesis, x: np.ndarray) -> np.ndarray:
        """What the nominal model itself says of its numbers: within a factor of about two, in residual units.

        It keeps a parameter that the excitation does not reach at its nominal value, and weighs nothing against data that do:
        a parameter that is wrong by half costs one unit of chi-square, times ``prior_weight``.
        """
        count, rows, at, nominal = h.prior_terms
        said = np.zeros(count)
        said[rows] = math.sqrt(self.prior_weight) * ((x[at] - nominal) * TWICE)
        return said

    def prior_slope(self, h: Hypothesis) -> tuple[np.ndarray, np.ndarray, float]:
        """Rows and columns of the prior's Jacobian that are not zero, and their value."""
        _, rows, at, _ = h.prior_terms
        return rows, at, math.sqrt(self.prior_weight) * TWICE
