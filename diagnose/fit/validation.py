"""Held-out errors other than that of the free run, and fits to other parts of the recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

import numpy as np

from diagnose.data.experiment import hold_out_blocks
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView, highest_observer_gain
from diagnose.thresholds import FAR, MATERIAL, SAME, SMALL
from mjsim.axis import Axis

__all__ = ["error_on", "in_blocks", "observed_error", "pooled", "predicted_samples"]


def pooled(fitter: Fitter, fitted: Fitted) -> Fitted:
    """A structure with its shared parameters fitted to the estimation and the held-out recordings together.

    Can it explain them all? What one leaves open (a stiffness that is not excited) another may settle, and is no missing
    physics. One that leaves much of its own cannot.
    """
    if fitter.above(fitted, FAR) and (fitter.spent or not fitted.rough):
        return fitted
    asked = (fitted.key, fitter.whitening.tobytes())
    known = fitter.engine.pooled.get(asked)
    if known is None or abs(known[0] - fitted.chi2) >= SAME * fitted.chi2:  # else it is the same fit, polished
        known = fitter.engine.pooled[asked] = fitted.chi2, _fit_pooled(fitter, fitted)
    return known[1]


def _fit_pooled(fitter: Fitter, fitted: Fitted) -> Fitted:
    everything = (*fitter.experiments, *fitter.held_out)
    wider = fitter.related(fitter.problem.on(everything, everything).relax(prior_weight=1.0))
    # one that leaves much of both need not be known to the last digit
    much = fitter.noise.cost_at(FAR, sum(int(np.sum(fitter.counted(e))) for e in everything))
    h = wider.hypothesis(fitted.effects, fitted.linear, fitted.own)
    joint = (wider.by_secants if h.rough else partial(wider.fit, iterations=15, rival=True))(h, slow=(much, SAME))
    fitter.count_work(wider.work)
    if not joint.ok:
        return fitted
    own = {k: v for k, v in joint.own.items() if k[2] < len(fitter.experiments)}
    h = fitter.hypothesis(joint.effects, joint.linear, own)
    return dataclasses.replace(fitted, hypothesis=h, fit=dataclasses.replace(fitted.fit, x=h.start))


def in_blocks(fitter: Fitter) -> Fitter | None:
    """A fitter that holds out every third stretch of each estimation recording; None where stretches are held out already."""
    if {id(e.recording) for e in fitter.experiments} & {id(e.recording) for e in fitter.held_out}:
        return None
    masks = [hold_out_blocks(e.recording) for e in fitter.experiments]
    fitted, held = (
        tuple(dataclasses.replace(e, counts=e.counts & m[part]) for e, m in zip(fitter.experiments, masks, strict=True))
        for part in (0, 1)
    )
    return fitter.related(fitter.problem.on(fitted, fitter.experiments, held_out=held))


def predicted_samples(fitter: Fitter, fitted: Fitted, count: int = 6, seed: int = 0) -> list[np.ndarray] | None:
    """Which held-out samples (N,), for each recording, a model predicts in spite of the errors of its parameters.

    Models drawn by the covariance of the fit are run beside it. Once they come apart by more than ``MATERIAL`` of the noise
    variance, over a tenth of a second, the free run is no prediction: events come at other moments, and the rest follows. They
    may come together again, but then with each other and not with the machine. None where the model is smooth, or predicts too
    little.
    """
    h = fitted.hypothesis
    if not fitted.rough:
        return None
    models = [h.axis(x, 0) for x in fitted.covariance_draws(np.ones(count), seed)]
    out = []
    for experiment in fitter.held_out:
        solved = fitter.own_values(h, fitted, experiment)
        s = fitter.view.signals(solved[0], experiment, solved[1]) if solved is not None else None
        if s is None or solved is None:
            return None
        runs = fitter.map([partial(fitter.view.signals, _with_phases(m, solved[0]), experiment, solved[1]) for m in models])
        # one that cannot be run has diverged
        spread = [np.full(len(s.predicted), np.inf) if r is None else (r.predicted - s.predicted) ** 2 for r in runs]
        width = max(1, round(0.1 / experiment.recording.dt / fitter.view.decimate))
        local = np.convolve(np.mean(spread, axis=0), np.ones(width) / width, "same")
        apart = np.flatnonzero(local >= MATERIAL * fitter.sigma(experiment) ** 2)
        until = int(apart[0]) if len(apart) else len(local)
        out.append(fitter.counted(experiment) & (np.arange(len(local)) < until))
    share = sum(int(s.sum()) for s in out) / sum(int(np.sum(fitter.counted(e))) for e in fitter.held_out)
    return out if share >= SMALL else None


def error_on(fitter: Fitter, fitted: Fitted, samples: Sequence[np.ndarray]) -> float | None:
    """Mean square of the weighted, whitened held-out error on some samples of each recording; None without any."""
    total, count = 0.0, 0
    for experiment, chosen in zip(fitter.held_out, samples, strict=True):
        solved = fitter.own_values(fitted.hypothesis, fitted, experiment)
        e = fitter.error(solved[0], experiment, solved[1]) if solved is not None else None
        if e is None:
            return None
        w, keep = fitter.whitened(e, experiment)
        total += float(np.sum(w[keep & chosen] ** 2))
        count += int(np.sum(keep & chosen))
    return total / count if count else None


def observed_error(fitter: Fitter, fitted: Fitted, gain: float) -> float | None:
    """Mean square of the weighted, whitened held-out error under an observer gain [1/s]; None where it cannot be computed."""
    if not isinstance(fitter.view, MotionView) or gain > highest_observer_gain(fitted.axis):
        return None
    held = fitter.related(fitter.problem.under_observer(gain, fitter.held_out)).validate(fitted)
    return None if held is None else held.chi2 / float(np.sum(held.n))


def _with_phases(model: Axis, like: Axis) -> Axis:
    """A model with the phases of another one."""
    effects = tuple(
        a.with_values({spec.name: b.values[spec.name] for spec in a.specs() if spec.nuisance})
        for a, b in zip(model.effects, like.effects, strict=True)
    )
    return dataclasses.replace(model, effects=effects)
