"""An encoder that errs over its turn: noise that repeats with the angle, and the rival of every position-locked effect.

The angle is read as q + a sin(n q + phi), the velocity as its derivative: v a n cos(n q + phi), whatever the speed. A torque or a
transmission error of the same order reaches the velocity through the mechanism, which answers to each speed in its own way.
"""

from __future__ import annotations

import numpy as np

from diagnose.fitter import Fitted, Fitter
from mjsim.effects import Effect
from mjsim.quantity import Motion

__all__ = ["TURNS", "encoder_gain", "gain_beside_encoder"]

TURNS = range(1, 9)  # orders of an encoder's turn
NEAR = 12  # orders looked at on either side of the effect's own, a quarter of a line's width apart


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
    J = poorer.fit.J
    scale = np.linalg.norm(J, axis=0) + 1e-300
    q, _ = np.linalg.qr(J / scale)
    angles, speeds = [], []
    for i, experiment in enumerate(fitter.experiments):
        h, x = poorer.hypothesis, poorer.fit.x
        s = fitter.view.signals(h.axis(x, i), experiment, h.initial(x, i))
        if s is None or experiment.recording.angle is None:
            return 0.0
        angles.append(experiment.recording.angle)
        speeds.append(s.predicted)
    travel = max(float(np.ptp(a)) for a in angles)
    if travel <= 0:
        return 0.0
    best = 0.0
    for n in own + np.arange(-NEAR, NEAR + 1) * 0.25 * 2 * np.pi / travel:
        columns = []
        at = 0
        for angle, speed, experiment in zip(angles, speeds, fitter.experiments, strict=True):
            for wave in (np.cos(n * angle), np.sin(n * angle)):
                w, keep = fitter.whitened(speed * wave, experiment)
                column = np.zeros(len(poorer.fit.residual))
                column[at : at + int(keep.sum())] = w[keep]
                columns.append(column)
            at += int(keep.sum())
        c = np.column_stack(columns)
        c -= q @ (q.T @ c)
        fitted = np.linalg.lstsq(c, poorer.fit.residual, rcond=1e-10)[0]
        best = max(best, float(poorer.fit.residual @ (c @ fitted)))
    return best


def gain_beside_encoder(fitter: Fitter, poorer: Fitted, richer: Fitted) -> float:
    """How far the chi-square falls from one structure to the other when the encoder may err at each whole order of its turn.

    Amplitudes and phases are each recording's own, and both structures' parameters follow (to first order). Infinite where there
    is no angle, the axis slides or the velocity is not judged.
    """
    left = [_beside(fitter, f) for f in (poorer, richer)]
    if left[0] is None or left[1] is None:
        return float("inf")
    return left[0] - left[1]


def _beside(fitter: Fitter, fitted: Fitted) -> float | None:
    """Chi-square of a fit once whole orders of the encoder's turn are fitted to its residual as well."""
    if fitter.view.channel != "velocity" or fitter.nominal.chain.motion is not Motion.HINGE:
        return None
    columns = [fitted.fit.J]
    at = 0
    for i, experiment in enumerate(fitter.experiments):
        h, x, angle = fitted.hypothesis, fitted.fit.x, experiment.recording.angle
        s = fitter.view.signals(h.axis(x, i), experiment, h.initial(x, i))
        if s is None or angle is None:
            return None
        own = np.zeros((len(fitted.fit.residual), 0))
        for n in TURNS:
            if n * float(np.ptp(angle)) < 3 * np.pi:  # of less than one and a half periods nothing tells
                continue
            for wave in (np.cos(n * angle), np.sin(n * angle)):
                w, keep = fitter.whitened(s.predicted * wave, experiment)
                column = np.zeros((len(fitted.fit.residual), 1))
                column[at : at + int(keep.sum()), 0] = w[keep]
                own = np.hstack([own, column])
        at += int(fitter.whitened(s.predicted, experiment)[1].sum())
        columns.append(own)
    c = np.hstack(columns)
    q, _ = np.linalg.qr(c / (np.linalg.norm(c, axis=0) + 1e-300))
    r = fitted.fit.residual
    return float(r @ r - np.sum((q.T @ r) ** 2))
