"""An encoder that errs over its turn: noise that repeats with the angle, and the rival of every position-locked effect.

The angle is read as q + a sin(n q + phi), the velocity as its derivative: v a n cos(n q + phi), whatever the speed. A torque or a
transmission error of the same order reaches the velocity through the mechanism, which answers to each speed in its own way.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import orthonormal
from diagnose.thresholds import ORDERS_BESIDE
from mjsim.effects import Effect
from mjsim.quantity import Motion

__all__ = ["encoder_gain", "fit_with_encoder_error", "gain_with_encoder_error", "whole_orders"]


def encoder_gain(fitter: Fitter, poorer: Fitted, effect: Effect) -> float:
    """How far the chi-square of a structure falls when the encoder errs at about the order of a position-locked effect.

    Amplitude and phase are each recording's own. 0 where there is no angle, the effect has no order or the velocity is not
    judged.
    """
    if "cycles_per_rev" not in effect.values or fitter.view.channel != "velocity":
        return 0.0
    chain = fitter.nominal.chain
    body = chain.body(type(effect).angle_of or effect.place)
    own = effect.values["cycles_per_rev"] * chain.total_ratio(body or 0)
    shown = _angle_and_speed(fitter, poorer)
    if shown is None:
        return 0.0
    q = orthonormal(poorer.fit.J)
    travel = max(float(np.ptp(angle)) for angle, _ in shown)
    if travel <= 0:
        return 0.0
    best = 0.0
    for n in own + np.arange(-ORDERS_BESIDE, ORDERS_BESIDE + 1) * 0.25 * 2 * np.pi / travel:
        c = _columns(fitter, poorer, shown, [[float(n)]] * len(shown))
        c -= q @ (q.T @ c)
        fitted = np.linalg.lstsq(c, poorer.fit.residual, rcond=1e-10)[0]
        best = max(best, float(poorer.fit.residual @ (c @ fitted)))
    return best


def gain_with_encoder_error(fitter: Fitter, poorer: Fitted, richer: Fitted) -> float:
    """How far the chi-square falls from one structure to the other when the encoder may err at each whole order of its turn.

    Amplitudes and phases are each recording's own, and both structures' parameters follow (to first order). Infinite where there
    is no angle, the axis slides or the velocity is not judged.
    """
    left = fitter.map([partial(_chi2_with_encoder_error, fitter, f) for f in (poorer, richer)])
    if left[0] is None or left[1] is None:
        return float("inf")
    return left[0] - left[1]


def fit_with_encoder_error(fitter: Fitter, fitted: Fitted, least: float) -> Fitted | None:
    """The structure with parameters as they are when the encoder may err at each whole order of its turn, to first order.

    Free parameters bend to take up some of such an error, by a thousandth here, and the model then misses motion that is there.
    None where this does not lower chi-square by ``least``, or `gain_with_encoder_error` is infinite.
    """
    c = _with_encoder(fitter, fitted)
    if c is None:
        return None
    size = np.linalg.norm(c, axis=0) + 1e-300
    step = np.linalg.lstsq(c / size, -fitted.fit.residual, rcond=1e-8)[0] / size
    x = np.clip(fitted.fit.x + step[: len(fitted.fit.x)], *fitted.hypothesis.bounds)
    beside = fitter.fit(fitted.hypothesis, x, iterations=0)
    left = _chi2_with_encoder_error(fitter, beside) if beside.ok else None
    return beside if left is not None and fitted.chi2 - left > least else None


def _with_encoder(fitter: Fitter, fitted: Fitted) -> np.ndarray | None:
    """Sensitivities of a fit and, beside them, what whole orders of the encoder's turn would leave: columns (M, k)."""
    if fitter.view.channel != "velocity" or fitter.nominal.chain.motion is not Motion.HINGE:
        return None
    shown = _angle_and_speed(fitter, fitted)
    if shown is None:
        return None
    return np.hstack([fitted.fit.J, _columns(fitter, fitted, shown, [whole_orders(angle) for angle, _ in shown])])


def _chi2_with_encoder_error(fitter: Fitter, fitted: Fitted) -> float | None:
    """Chi-square of a fit once whole orders of the encoder's turn are fitted to its residual as well."""
    c = _with_encoder(fitter, fitted)
    if c is None:
        return None
    r = fitted.fit.residual
    return float(r @ r - np.sum((orthonormal(c).T @ r) ** 2))


def whole_orders(angle: np.ndarray) -> list[float]:
    """Whole orders of an encoder's turn that show in an angle (N,): of less than one period nothing tells."""
    return [float(n) for n in range(1, 9) if n * float(np.ptp(angle)) > 2 * np.pi]


def _angle_and_speed(fitter: Fitter, fitted: Fitted) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """(measured angle, fitted speed) of each experiment (N,), or None where there is none."""
    out = []
    for i, experiment in enumerate(fitter.experiments):
        h, x, angle = fitted.hypothesis, fitted.fit.x, experiment.recording.angle
        s = fitter.view.signals(h.axis(x, i), experiment, h.initial(x, i))
        if s is None or angle is None:
            return None
        out.append((angle, s.predicted))
    return out


def _columns(
    fitter: Fitter, fitted: Fitted, shown: Sequence[tuple[np.ndarray, np.ndarray]], orders: Sequence[Sequence[float]]
) -> np.ndarray:
    """What the residual of a fit (M,) holds of an encoder's errors at each experiment's orders: two columns for each."""
    out = [np.zeros((len(fitted.fit.residual), 0))]
    at = 0
    for (angle, speed), experiment, own in zip(shown, fitter.experiments, orders, strict=True):
        keep = fitter.whitened(speed, experiment)[1]
        count = int(keep.sum())
        waves = np.zeros((len(fitted.fit.residual), 2 * len(own)))
        for k, wave in enumerate(trig(n * angle) for n in own for trig in (np.cos, np.sin)):
            waves[at : at + count, k] = fitter.whitened(speed * wave, experiment)[0][keep]
        out.append(waves)
        at += count
    return np.hstack(out)
