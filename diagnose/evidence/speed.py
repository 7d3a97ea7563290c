"""A torque that depends on the speed in any way: what it explains beside a structure, to first order.

The torque is a cubic spline of the speed of body 0 beside a multiple of its sign,

    tau(v) = c_0 sign(v) + sum over i of c_i B_i(v),

and acts through the fitted linear axis (`diagnose.evidence.orders.torque_to_velocity`).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from diagnose.data.experiment import middle, smooth_velocity
from diagnose.evidence.orders import torque_to_velocity
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import orthonormal
from diagnose.problem.problem import bounded
from diagnose.thresholds import INTERVALS
from mjsim.signals import lfilter
from mjsim.torque_map import MapAxis, basis

__all__ = ["left_beside_speed"]


def left_beside_speed(fitter: Fitter, *structures: Fitted) -> list[float] | None:
    """Chi-square of each structure once a function of the speed is fitted to its residual beside its own parameters.

    None where a body does not move, or no such response is bounded.
    """
    found = fitter.map([partial(_left, fitter, f) for f in structures])
    left = [value for value in found if value is not None]
    return left if len(left) == len(found) else None


def _left(fitter: Fitter, fitted: Fitted) -> float | None:
    columns = _responses(fitter, fitted)
    if columns is None:
        return None
    r = fitted.fit.residual
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0.0] / size[size > 0.0]
    return float(r @ r - np.sum((orthonormal(np.hstack([fitted.fit.J, columns])).T @ r) ** 2))


def _responses(fitter: Fitter, fitted: Fitted) -> np.ndarray | None:
    """What the residual of a fit (M,) holds of each function of the speed (M, k)."""
    speeds = [smooth_velocity(e.recording) for e in fitter.experiments]
    spline = MapAxis.spanning("velocity", np.concatenate(speeds), INTERVALS[0])
    if spline is None:
        return None
    parts = []
    for i, (experiment, v) in enumerate(zip(fitter.experiments, speeds, strict=True)):
        torque = np.column_stack([np.sign(v), basis(spline, v)])
        response = _response(fitter, fitted, i, torque)
        if not bounded(response).all():
            return None
        white = [fitter.whitened(column, experiment) for column in response.T]
        parts.append(np.column_stack([w[keep] for w, keep in white]))
    own = len(fitted.fit.residual) - sum(len(p) for p in parts)
    return np.concatenate([*parts, np.zeros((own, parts[0].shape[1]))])


def _response(fitter: Fitter, fitted: Fitted, i: int, torque: np.ndarray) -> np.ndarray:
    """The judged channel of an experiment to torques (N, k) on body 0: itself where the torque is judged."""
    if fitter.view.channel == "torque":
        return np.asarray(torque[:: fitter.view.decimate] / fitter.nominal.chain.gain)
    recording = fitter.experiments[i].recording
    axis = fitted.hypothesis.axis(fitted.fit.x, i)
    b, a = torque_to_velocity(axis, recording.dt, about=middle(recording), by_velocity=recording.angle is None)
    return np.asarray(lfilter(b, a, torque))
