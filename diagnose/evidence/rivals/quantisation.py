"""The step of an encoder as the rival of an added effect: what a reading within half a step shows is not the effect.

An encoder reads the angle to half a step, and at rest or in slow motion its error is no noise: it lasts, and repeats with the
motion. A structure whose errors stay within half a step is contradicted by no sample. What they have beyond it,

    max(|e| - step / 2, 0),

is zero for the true motion. Set-membership estimation: M. Milanese, A. Vicino, Automatica 27 (1991) 997.
"""

from __future__ import annotations

import math

import numpy as np

from diagnose.evidence.context import Context
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.result import Diagnosis
from diagnose.thresholds import SMALL
from mjsim.signals import value_step

__all__ = ["beyond_the_step", "no_reading_of_the_encoder", "within_the_step"]


def no_reading_of_the_encoder(context: Context, pair: Pair) -> Outcome:
    """Refuse an effect without which the errors stay within half a step of the encoder, in every recording."""
    before = pair.before
    asked = (before.key, before.chi2)
    if asked not in context.memo.beyond:
        context.memo.beyond[asked] = beyond_the_step(context.fitter, before)
    beyond = context.memo.beyond[asked]
    return Veto("quantisation", {"beyond": beyond, "needed": SMALL}) if beyond < SMALL else PASS


def beyond_the_step(fitter: Fitter, fitted: Fitted) -> float:
    """Mean square of the errors of the angle beyond half a step over that of a step (step^2 / 12), the largest of the recordings.

    Infinite where no angle is judged, or where one has no step.
    """
    most = 0.0
    if fitter.view.channel != "angle":
        return math.inf
    for experiment in (*fitter.experiments, *fitter.held_out):
        angle = experiment.recording.angle
        step = 0.0 if angle is None else value_step(angle)
        own = fitter.own_values(fitted.hypothesis, fitted, experiment) if step > 0 else None
        e = None if own is None else fitter.error(own[0], experiment, own[1])
        if e is None:
            return math.inf
        most = max(most, _beyond(e[fitter.counted(experiment)], step))
    return most


def within_the_step(result: Diagnosis) -> bool:
    """Whether the errors of a diagnosis's model stay within half a step of the encoder, in every recording."""
    if result.channel != "angle":
        return False
    steps = [value_step(t.measured) for t in result.traces]
    return bool(steps) and all(
        step > 0 and _beyond((t.measured - t.corrected)[t.counted], step) < SMALL
        for t, step in zip(result.traces, steps, strict=True)
    )


def _beyond(e: np.ndarray, step: float) -> float:
    """Mean square of errors (n,) beyond half a step over step^2 / 12."""
    over = np.maximum(np.abs(e) - 0.5 * step, 0.0)
    return float(np.mean(over**2)) / (step**2 / 12.0)
