"""Whether the input follows the value of the angle, as a position command does, and is no torque of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from diagnose.check.machine import Machine
from diagnose.check.regression import regress
from diagnose.check.relation import FEWEST, SAMPLED, SHARE, TOP, WINDOW, Fit, Ratio, Relation, Signals
from diagnose.check.scale import Scale
from diagnose.check.spectrum import Spectrum, clear_band, noise_level
from diagnose.check.thresholds import FOLLOWED, PARAMETER_FACTOR, RATIO_TOLERANCE, RESOLVED, Z_TEST

__all__ = ["Following", "follows"]


@dataclass(frozen=True)
class Following:
    """How the input follows the angle: slope, delay of the angle behind it [s], part of the input's variance."""

    slope: float
    delay: float
    explained: float


def follows(signals: Signals | None, scale: Scale | None, machine: Machine, hold: str) -> Following | None:
    """The fit of input(t - delay) = slope angle + b velocity + c, where it explains the input and the input is no torque.

    Under a linear servo, u_true = kp (u - q) - kv q', the input is q + (J q'' + f q' + g(q)) / kp: the relation of a torque, with
    inertia, friction and weight over kp, and the angle with a factor of exactly 1 beside them. Of a torque that factor is the
    stiffness of a spring that the model lacks, mostly 0; one of 1 N m/rad that takes most of the torque looks the same. Where the
    motion does not determine it, as where sine and angle are one, the input is a torque if every ratio to the model that is
    determined is that of a wrong parameter.
    """
    if signals is None or signals.angle is None:
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
    factor = _factor_of_angle(signals, machine, hold)
    if factor is None or factor.error > RATIO_TOLERANCE:
        torque = scale is not None and any(_agrees(fit) for fit in scale.labelled.fits)
    else:
        torque = abs(factor.value - 1.0) > RATIO_TOLERANCE + Z_TEST * factor.error
    return None if torque else Following(slope, found.delay, found.explained)


def _factor_of_angle(signals: Signals, machine: Machine, hold: str) -> Ratio | None:
    """The coefficient of the angle beside all torques of the relation; None where the band holds too few samples."""
    fit = Relation(signals, machine, "angle").fit(hold, signals.angle)
    return None if fit is None else fit.extra


def _agrees(fit: Fit) -> bool:
    """Whether a ratio of a fit is determined, and each that is lies within what a wrong parameter explains."""
    ratios = [r for r in (fit.inertia, fit.gravity) if r is not None and r.determined(RESOLVED)]
    return bool(ratios) and all(1 / PARAMETER_FACTOR < r.value < PARAMETER_FACTOR for r in ratios)
