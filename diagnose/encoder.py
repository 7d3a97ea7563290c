"""An encoder that errs over its turn: noise that repeats with the angle, and the rival of every position-locked effect.

The angle is read as q + a sin(n q + phi), the velocity as its derivative: v a n cos(n q + phi), whatever the speed. A torque or a
transmission error of the same order reaches the velocity through the mechanism, which answers to each speed in its own way.
"""

from __future__ import annotations

import numpy as np

from diagnose.fitter import Fitted, Fitter
from mjsim.effects import Effect

__all__ = ["encoder_gain"]

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
