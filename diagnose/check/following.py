"""Whether the input follows the value of the angle, as a position command does, and is no torque of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from diagnose.check.regression import regress
from diagnose.check.relation import FEWEST, SAMPLED, SHARE, TOP, WINDOW, Signals
from diagnose.check.scale import Evidence, Scale
from diagnose.check.spectrum import Spectrum, clear_band, noise_level
from diagnose.check.thresholds import FOLLOWED, PARAMETER_FACTOR, RESOLVED

__all__ = ["Following", "follows"]


@dataclass(frozen=True)
class Following:
    """How the input follows the angle: slope, delay of the angle behind it [s], part of the input's variance."""

    slope: float
    delay: float
    explained: float


def follows(signals: Signals | None, scale: Scale | None) -> Following | None:
    """The fit of input(t - delay) = slope angle + b velocity + c, where it explains the input and the model's torques do not."""
    if signals is None or signals.angle is None:
        return None
    if scale is not None and any(_agrees(scale.labelled, i) for i in range(len(scale.labelled.fits))):
        return None
    dt, n = signals.dt, len(signals.angle)
    duration, top = (n - 1) * dt, min(TOP, SAMPLED / dt)
    top = min(top, clear_band(Spectrum.of(signals.angle, dt, top), noise_level(signals.angle), dt))
    count, window = math.floor(2 * top * duration), min(WINDOW, SHARE * duration)
    time = np.linspace(0.0, duration, max(count, 1) + 1)
    inner = (time >= window) & (time <= duration - window)
    if count <= FEWEST or np.sum(inner) <= FEWEST:
        return None
    q, u = Spectrum.of(signals.angle, dt, top), Spectrum.of(signals.torque, dt, top)
    X = np.column_stack([q.derivative(0, count), q.derivative(1, count), np.ones(count + 1)])[inner]
    ones = np.ones(len(u.frequency), complex)
    found = regress(X, lambda d: u.delayed(d, ones, count)[inner], (-window, window), top)
    slope = float(found.coefficients[0])
    if found.explained < FOLLOWED or not 1 / PARAMETER_FACTOR < slope < PARAMETER_FACTOR:
        return None
    return Following(slope, found.delay, found.explained)


def _agrees(evidence: Evidence, index: int) -> bool:
    """Whether a ratio of a fit is determined and within what a wrong parameter explains."""
    fit = evidence.fits[index]
    ratios = [r for r in (fit.inertia, fit.gravity) if r is not None and r.determined(RESOLVED)]
    return any(1 / PARAMETER_FACTOR < r.value < PARAMETER_FACTOR for r in ratios)
