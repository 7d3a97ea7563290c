"""How much earlier than its rows an input acts, where a log is compared by force.

No drive acts ahead of its command. Stamps do that, and so does a simulator that takes its steps semi-implicitly: under a timestep
h its position answers a held torque h / 2 early. A step of the torque then leaves an error of the lead times its rate in the
torque that is compared, which a flexible mode resembles. It is linear in a small lead, so that a regression finds that:

    measured(t) - needed(t) = -early u'(t)
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.whiten import effective_share
from diagnose.problem.view import ForceView

__all__ = ["taken_early"]


def taken_early(fitter: Fitter) -> Fitter:
    """The fitter whose view takes the input as early as the refitted nominal model shows it; as given where it shows no lead.

    Up to half a sample: what is more is another hold of the input. The error is linear in a lead but for what other numbers take
    of it, so that three rounds do.
    """
    view = fitter.view
    if not isinstance(view, ForceView):
        return fitter
    first = best = fitter.fit(fitter.hypothesis(()))
    now = fitter
    dt = fitter.experiments[0].recording.dt
    for _ in range(3):
        if not best.ok:
            return fitter
        early = min(max(_early(now, best), 0.0), 0.5 * dt)
        trial = Fitter.of(dataclasses.replace(fitter.problem, view=dataclasses.replace(view, early=early)), fitter.engine)
        found = trial.fit(trial.hypothesis((), best.linear, best.own))
        if not found.ok or not found.chi2 < best.chi2:
            break
        now, best = trial, found
    if now is fitter or not best.chi2 > 0:
        return fitter
    gain = effective_share(now, best) * best.n * math.log(first.chi2 / best.chi2)
    return now if gain > fitter.noise.prices.entry + fitter.noise.prices.price else fitter


def _early(fitter: Fitter, fitted: Fitted) -> float:
    """Lead [s] of the input by the error of a fit, beside that of its view."""
    view = fitter.view
    assert isinstance(view, ForceView)
    product = square = 0.0
    for i, experiment in enumerate(fitter.experiments):
        s = view.signals(fitted.hypothesis.axis(fitted.fit.x, i), experiment, None)
        if s is None:
            return view.early
        keep = view.counts(experiment)
        rate = view.low_passed(np.gradient(experiment.recording.torque, experiment.recording.dt)[:, None], experiment)[:, 0]
        product += float((s.measured - s.predicted)[keep] @ rate[keep])
        square += float(rate[keep] @ rate[keep])
    return view.early - product / square if square > 0 else view.early
