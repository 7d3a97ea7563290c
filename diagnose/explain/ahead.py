"""How far ahead a model can be trusted: its error when it is corrected by what was measured up to a while before.

A free run is never corrected, so that a small torque that is missing grows into a large error of motion. The k-step error is that
of the best prediction from k samples before. Restarted from a measured state a model would start with the sensor's noise in it;
here the past corrects it through a noise model instead, as for any output-error model with coloured noise. Let e be the free-run
error and A(q) e = w its autoregressive model, fitted to the estimation recordings. Then (L. Ljung, System Identification (1999),
ch. 3.2)

    1 / A = E_k + q^-k F_k / A,    error k samples ahead = E_k(q) w(t),    E_k = the first k terms of 1 / A

It is right under noise of any colour: white sensor noise cannot be predicted, stays in the error and is its floor; motion that
the model misses is predicted as far as its past tells, and the rest is the error of the model over that while.
"""

from __future__ import annotations

import numpy as np

from diagnose.explain.locate import played
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.whiten import levinson
from diagnose.thresholds import AHEAD_SECONDS
from mjsim.signals import lfilter

__all__ = ["k_step"]


def k_step(
    fitter: Fitter, fitted: Fitted, horizons: tuple[float, ...] = AHEAD_SECONDS, most: int = 300
) -> tuple[tuple[float, float], ...]:
    """(horizon [s], rms error that far ahead on the held-out samples in the view's unit), by the model's own noise model.

    A horizon is a whole number of samples, one at least: of those that are the same number, the first stands for all.
    ``most``: lags of the autoregressive model at most; white noise hides a slow error from a short one.
    """
    every = fitter.view.decimate
    runs = played(fitter, fitted)
    own = [r for r in runs if r.role == "estimation"]
    order = min(most, min(len(r.e) for r in own) // 10)
    total, n = np.zeros(order + 1), 0
    for r in own:
        keep = fitter.counted(r.experiment)
        e = np.where(keep, r.e, 0.0) / fitter.sigma(r.experiment)
        size = 2 ** int(np.ceil(np.log2(2 * len(e))))
        total += np.fft.irfft(np.abs(np.fft.rfft(e, size)) ** 2, size)[: order + 1]
        n += int(keep.sum())
    if not total[0] > 0:
        return tuple((h, 0.0) for h in horizons)
    _, variance = levinson(total / n, order)
    bic = n * np.log(np.maximum(variance, 1e-300)) + np.log(n) * np.arange(order + 1)
    a, _ = levinson(total / n, int(np.argmin(bic)))
    errors = {id(r.experiment.recording): r.e for r in runs}
    out: dict[float, float] = {}
    for horizon in horizons:
        seconds = horizon
        squares, count = 0.0, 0
        for experiment in fitter.held_out:
            error = errors.get(id(experiment.recording))
            if error is None:
                return ()
            step = experiment.recording.dt * every
            k = max(1, round(horizon / step))
            seconds = k * step
            ahead = lfilter([1.0], a, np.concatenate([[1.0], np.zeros(k - 1)]))
            w = lfilter(ahead, [1.0], lfilter(a, [1.0], error))
            keep = fitter.counted(experiment).copy()
            keep[: k + len(a)] = False  # before that there is no past to predict from
            squares += float(np.sum(w[keep] ** 2))
            count += int(keep.sum())
        if count:
            out.setdefault(float(f"{seconds:.6g}"), float(np.sqrt(squares / count)))
    return tuple(out.items())
