"""Phases and states at the start, which each recording has of its own: estimated anew where a recording was not fitted."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from diagnose.data.experiment import Experiment
from diagnose.fit.fitted import Fitted
from diagnose.fit.least_squares import Run, Status, levenberg_marquardt
from diagnose.problem.hypothesis import Hypothesis
from diagnose.problem.problem import Problem
from diagnose.problem.start_state import is_of_start
from diagnose.thresholds import TWICE
from mjsim.axis import Axis

__all__ = ["nuisance_values"]


def nuisance_values(problem: Problem, run: Run, fitted: Fitted, experiment: Experiment) -> tuple[Axis, np.ndarray | None] | None:
    """The fitted axis with a recording's own phases and start, estimated on it if it is held out; None if that fails.

    Stretches that are held out of a fitted recording have that recording's own.
    """
    h = fitted.hypothesis
    same = [i for i, e in enumerate(problem.experiments) if e.recording is experiment.recording]
    at = same[0] if same else 0
    alone = Hypothesis.build(
        h.nominal, fitted.effects, problem.scales, 1, (problem.begin(experiment),), fitted.linear,
        {(o, n, 0): v for (o, n, r), v in fitted.own.items() if r == at and (same or not is_of_start(o, n))}, problem.varies,
    )  # fmt: skip
    free = np.array([e.recording >= 0 for e in alone.entries])
    x = alone.start.copy()
    if free.any() and not same:
        _, _, place, nominal = alone.prior_terms
        prior = free[place]

        def residual(z: np.ndarray) -> np.ndarray | None:
            y = x.copy()
            y[free] = z
            try:
                r = problem.weighted(alone.axis(y, 0), experiment, alone.initial(y, 0))
            except ValueError:
                return None
            said = math.sqrt(problem.prior_weight) * TWICE * (y[place] - nominal)[prior]
            return None if r is None else np.concatenate([r, said])

        lower, upper = alone.bounds
        phases = [i for i, e in enumerate(alone.entries) if e.recording >= 0 and e.name == "phase_rad"]
        start = x[free]
        if phases:  # the response turns with the phase: the basin is the quarter turn with the least error
            starts = []
            for turn in (0.0, 1.57, 3.14, -1.57):
                y = x.copy()
                y[phases] += turn
                starts.append(y[free])
            costs = [math.inf if r is None else float(r @ r) for r in run([partial(residual, z0) for z0 in starts])]
            start = starts[int(np.argmin(costs))]
        best = levenberg_marquardt(
            residual, start, (lower[free], upper[free]), step=np.full(int(free.sum()), 1e-3), run=run,
            max_iterations=8, reach=alone.reach[free],
        )  # fmt: skip
        if best.status is Status.FAILED:
            return None
        x[free] = best.x
    return alone.axis(x, 0), alone.initial(x, 0)
