"""k-step prediction and simulation with a fitted initial state."""

from __future__ import annotations

import numpy as np

from ident.data import IOData
from ident.model import PolyModel
from mjsim.errors import InputError
from mjsim.signals import lfilter

__all__ = ["predicted", "simulated"]

_ONE = np.ones(1)


def _pulse_responses(den: np.ndarray, count: int, size: int) -> np.ndarray:
    """(size, count): the response of 1/den to a pulse, delayed by 0 .. count - 1."""
    pulse = np.zeros(size)
    pulse[0] = 1.0
    h = lfilter(_ONE, den, pulse)
    return np.stack([np.r_[np.zeros(i), h[: size - i]] for i in range(count)], axis=1) if count else np.empty((size, 0))


def simulated(model: PolyModel, data: IOData, *, initial: bool = True) -> np.ndarray:
    """``G u`` plus the free response that fits the data best (``initial=False``: from rest), shape (N,); MATLAB ``compare``."""
    s = model.structure
    den = np.polymul(model.A, model.F)
    y = lfilter(model.B, den, np.asarray(data.u), s.nk)
    count = min(max(s.na + s.nf, s.nb + s.nk - 1), len(data) // 4)
    if not initial or count == 0 or not np.all(np.isfinite(y)):
        return y
    size = len(data) if not model.stable else min(len(data), _settling(den, len(data)))
    basis = _pulse_responses(den, count, size)
    scale = np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
    weights = np.linalg.lstsq(basis / scale, data.y[:size] - y[:size], rcond=1e-9)[0]
    y[:size] += (basis / scale) @ weights
    return y


def _settling(den: np.ndarray, limit: int) -> int:
    """Samples until the slowest pole has decayed to 1e-8, at least four times the order."""
    radius = float(np.max(np.abs(np.roots(den)), initial=0.0))
    if radius >= 1.0:
        return limit
    return int(min(limit, max(4 * den.size, 20, np.log(1e-8) / np.log(max(radius, 1e-3)))))


def predicted(model: PolyModel, data: IOData, horizon: int = 1) -> np.ndarray:
    """k-step-ahead prediction, shape (N,); MATLAB ``predict(sys, data, k)``.

    ``yhat(t|t-k) = W_k G u + (1 - W_k) y`` with ``W_k = Hbar_k / H`` and ``Hbar_k`` the first k terms of H's impulse response
    (Ljung, section 3.2). The initial state of the plant is fitted to the data, the noise filter starts at rest.
    """
    if not (isinstance(horizon, int) and 1 <= horizon <= len(data)):
        raise InputError("prediction horizon", f"{horizon!r}", f"a whole number of samples from 1 to {len(data)}")
    pulse = np.zeros(horizon)
    pulse[0] = 1.0
    noise_den = np.polymul(model.A, model.D)
    head = lfilter(model.C, noise_den, pulse)
    v = data.y - simulated(model, data)
    weighted = lfilter(noise_den, model.C, v)  # 1/H v = e
    predicted: np.ndarray = np.asarray(data.y) - lfilter(head, _ONE, weighted)
    return predicted
