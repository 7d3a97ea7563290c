"""A velocity channel that was made of the angle channel: it is no second measurement."""

from __future__ import annotations

import dataclasses
import threading
from collections import OrderedDict
from hashlib import sha256

import numpy as np

from diagnose.check.content import content_end
from diagnose.data.experiment import angle_noise_level
from diagnose.data.noise import white_noise_level
from diagnose.thresholds import LEAST_SAMPLES, MOST, SMALL, TAPS
from mjsim.recording import Recording
from mjsim.signals import plain_step

__all__ = ["without_derived_velocity"]

_answers: OrderedDict[bytes, bool] = OrderedDict()  # of `_filtered`, by the digest of its arguments
_lock = threading.Lock()


def without_derived_velocity(recording: Recording) -> Recording:
    """The recording without a velocity that was made of its angle: a difference, or one that a linear filter passed.

    Such a channel says nothing that the angle does not, and with the same noise: half a sample late or early, it would be taken
    for a delay, its filter for the mechanism's own, and its agreement with the angle for a proof of motion.
    """
    v, q = recording.velocity, recording.angle
    if v is None or q is None or len(v) < 10:
        return recording
    steps = np.diff(q) / recording.dt
    noise = white_noise_level(v)
    made = ((v[1:], steps), (v[:-1], steps), (v[1:-1], 0.5 * (steps[1:] + steps[:-1])))
    if any(np.sqrt(np.mean((a - b) ** 2)) < SMALL * noise for a, b in made) or _filtered_once(v, q, recording.dt):
        return dataclasses.replace(recording, velocity=None)
    return recording


def _filtered_once(v: np.ndarray, q: np.ndarray, dt: float) -> bool:
    """`_filtered`, computed once for each pair of signals: a diagnosis asks up to five times, and the regression takes long."""
    digest = sha256(v.tobytes())
    digest.update(q.tobytes())
    digest.update(np.float64(dt).tobytes())
    key = digest.digest()
    answer = _answers.get(key)
    if answer is None:
        answer = _filtered(v, q, dt)
        with _lock:
            _answers[key] = answer
            while len(_answers) > 64:
                _answers.popitem(last=False)
    return answer


def _filtered(v: np.ndarray, q: np.ndarray, dt: float) -> bool:
    """Whether a velocity (N,) holds the noise of the angle (N,) behind a filter, v_k = sum_j h_j (q_(k-j+1) - q_(k-j)) / dt.

    A velocity that is measured by itself misses that sum by the noise of the angle behind h, at least; one that is made of the
    angle by less than `MOST` of its variance. The taps are fitted by least squares. An angle whose noise does not reach half the
    sampling rate tells nothing.
    """
    n = min(len(v) - 1, LEAST_SAMPLES)
    if n < 10 * TAPS or (plain_step(q) == 0 and content_end(q, dt) is not None):
        return False
    columns = np.lib.stride_tricks.sliding_window_view(np.diff(q[: n + 1]) / dt, 2 * TAPS + 1)
    y = v[TAPS : TAPS + len(columns)]
    h = np.linalg.lstsq(columns, y, rcond=None)[0]
    left = float(np.mean((y - columns @ h) ** 2))
    behind = float(np.sum(np.diff(h, prepend=0.0, append=0.0) ** 2)) * (angle_noise_level(q) / dt) ** 2
    return left < MOST * behind
