"""The refitted nominal model as the other arms build on it: the fitter of the diagnosis, no effects."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from diagnose.data.experiment import middle, prepare
from diagnose.evidence.orders import find_orders, torque_to_velocity
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView
from lab.benchmark.arms.base import Task
from mjsim.errors import InputError

__all__ = ["Refitted", "fitting", "orders", "refitted"]


@dataclass(frozen=True)
class Refitted:
    """The fit, its held-out free-run rms [rad/s], and its velocities [rad/s] on both recordings."""

    fitted: Fitted
    held_out_rms: float
    on_estimation: np.ndarray
    on_held_out: np.ndarray


@contextmanager
def fitting(task: Task) -> Iterator[Fitter]:
    """A fitter on the task's recordings, judged by motion, one thread."""
    fitter = Fitter(task.nominal, MotionView(), (prepare(task.estimation),), (prepare(task.held_out),), jobs=1)
    try:
        yield fitter
    finally:
        fitter.close()


def refitted(fitter: Fitter) -> Refitted:
    """Fit the nominal structure and run it free on both recordings. Raises InputError when it cannot be run."""
    fitted = fitter.fit(fitter.hypothesis(()))
    held = fitter.validate(fitted) if fitted.ok else None
    runs = []
    for experiment in (fitter.experiments[0], fitter.held_out[0]):
        solved = fitter.own_values(fitted.hypothesis, fitted, experiment) if fitted.ok else None
        signals = fitter.view.signals(solved[0], experiment, solved[1]) if solved is not None else None
        if signals is None or held is None:
            raise InputError(experiment.recording.source, "the refitted nominal model cannot be run", "a stable model")
        runs.append(signals.predicted)
    assert held is not None
    return Refitted(fitted, held.rms, *runs)


def orders(fitter: Fitter, fitted: Fitted) -> tuple[float, ...]:
    """Spatial orders that stand out of a residual: starts of what repeats over the angle, as the diagnosis takes them."""
    experiment = fitter.experiments[0]
    r = experiment.recording
    e = fitter.error(fitted.axis, experiment, fitted.hypothesis.initial(fitted.fit.x, 0))
    if r.angle is None or r.velocity is None or e is None:
        return ()
    b, a = torque_to_velocity(fitted.axis, r.dt, about=middle(r))
    return find_orders(e, r.angle, r.velocity, b, a, r.dt, keep=fitter.counted(experiment))
