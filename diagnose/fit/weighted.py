"""How errors are weighed in a fit: by the noise, whitened if need be, with what the nominal model says of its own numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from diagnose.data.experiment import Experiment
from diagnose.fit.fitted import Fitted
from diagnose.fit.least_squares import Residual, Run, bounded, residual_and_jacobian
from diagnose.problem.hypothesis import Hypothesis
from diagnose.problem.noise_model import KnownNoise, ModelError, NoiseModel
from diagnose.problem.view import View
from mjsim.axis import Axis
from mjsim.signals import lfilter, weigh_into

__all__ = ["PRIOR", "Weighted"]

PRIOR = 0.5  # relative standard deviation given to the nominal linear parameters


@dataclass
class Weighted:
    """Experiments, how a model of them is judged, and how its errors are weighed."""

    nominal: Axis
    view: View
    experiments: tuple[Experiment, ...]
    held_out: tuple[Experiment, ...]
    whitening: np.ndarray = field(default_factory=lambda: np.ones(1), kw_only=True)
    guide: float = field(default=1.0, kw_only=True)

    def __post_init__(self) -> None:
        self.closed = False
        self._clear: dict[tuple[int, int], np.ndarray] = {}
        self._counts = {id(e): self.view.counts(e) for e in (*self.experiments, *self.held_out)}
        self._sigma = {id(e): self.view.noise(e) or self._rough_noise(e) for e in (*self.experiments, *self.held_out)}
        told = all(self.view.noise(e) is not None for e in self.experiments)
        self.noise: NoiseModel = KnownNoise() if told else ModelError()

    def _rough_noise(self, experiment: Experiment) -> float:
        """A tenth of the nominal model's error: a weight where the noise is not known beforehand."""
        e = self.error(self.nominal, experiment, None)
        if e is None:
            return 1.0
        return 0.1 * float(np.sqrt(np.mean(e[self.counted(experiment)] ** 2)))

    def set_sigma(self, experiment: Experiment, sigma: float) -> None:
        """Weight of an experiment."""
        self._sigma[id(experiment)] = sigma

    def sigma(self, experiment: Experiment) -> float:
        """Noise rms used as weight."""
        return self._sigma[id(experiment)]

    def counted(self, experiment: Experiment) -> np.ndarray:
        """Mask of the compared samples that count."""
        return self._counts[id(experiment)]

    def error(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray | None:
        """Measured minus predicted at every compared sample, in the view's unit."""
        s = self.view.signals(axis, experiment, initial)
        if s is None:
            return None
        e = s.measured - s.predicted
        return e if bounded(e).all() else None

    def error_of(self, fitted: Fitted, i: int) -> np.ndarray | None:
        """The error of a fitted model on estimation experiment i."""
        h, x = fitted.hypothesis, fitted.fit.x
        return self.error(h.axis(x, i), self.experiments[i], h.initial(x, i))

    def weighted(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray | None:
        """The error whitened, weighted and cut to the samples that count."""
        out = np.empty(len(self.counted(experiment)))
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
        how = self.counted(experiment), self.whitening, self._telling(experiment)
        count = int(weigh_into(s.measured, predicted, self.sigma(experiment), *how, out))
        return None if count < 0 else count

    def whitened(self, e: np.ndarray, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
        """Weighted, whitened error (M,) and which of it counts: not the samples that the filter reaches past a gap."""
        w = e / self.sigma(experiment)
        if len(self.whitening) > 1:
            w = lfilter(self.whitening, [1.0], np.where(self.counted(experiment), w, 0.0))
        return w, self._telling(experiment)

    def _telling(self, experiment: Experiment) -> np.ndarray:
        """Which of the whitened errors count: not those that the filter reaches past a gap."""
        keep, p = self.counted(experiment), len(self.whitening) - 1
        if p == 0:
            return keep
        if (id(experiment), p) not in self._clear:
            reach = np.convolve(~keep, np.ones(p + 1))[: len(keep)] > 0
            reach[:p] = True
            self._clear[id(experiment), p] = keep & ~reach
        return self._clear[id(experiment), p]

    def residual(self, h: Hypothesis, roundings: Sequence[np.ndarray | None] = ()) -> Residual:
        """Residual vector over all estimation experiments as a function of the scaled vector.

        ``roundings``: those of their predictions, in place of their own.
        """

        def of(x: np.ndarray) -> np.ndarray | None:
            if self.closed:
                return None
            out, at = np.empty(sum(len(self.counted(e)) for e in self.experiments) + h.told[0]), 0
            for r, experiment in enumerate(self.experiments):
                try:
                    axis = h.axis(x, r)
                except ValueError:
                    return None
                count = self._weigh(axis, experiment, h.initial(x, r), out[at:], roundings[r] if roundings else None)
                if count is None:
                    return None
                at += count
            out[at : at + h.told[0]] = self.prior(h, x)
            return out[: at + h.told[0]]

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
        """The rounding of a prediction of experiment r."""
        try:
            s = self.view.signals(h.axis(x, r), self.experiments[r], h.initial(x, r))
        except ValueError:
            return None
        return None if s is None else s.rounding

    def linearised(
        self, h: Hypothesis, x: np.ndarray, step: float, run: Run, which: Sequence[int] | None = None
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Residual (N,) and Jacobian (N, p) at a scaled vector by secants of ``step``, or those of its columns ``which``."""
        slope = self.slope(h)
        residual = self.residual(h) if slope is None else slope(x)
        return residual_and_jacobian(residual, x, np.full(len(x), step), *h.bounds, run, which)

    def prior(self, h: Hypothesis, x: np.ndarray) -> np.ndarray:
        """What the nominal model itself says of its numbers: within a factor of about two (PRIOR), in residual units.

        It keeps a parameter that the excitation does not reach from wandering off, and weighs nothing against data that do:
        a parameter that is wrong by half costs one unit of chi-square, times ``guide``.
        """
        count, rows, at, nominal = h.told
        said = np.zeros(count)
        said[rows] = math.sqrt(self.guide) * ((x[at] - nominal) / PRIOR)
        return said
