"""The nominal model with its linear parameters fitted: what most people do. Taken from the diagnosis where there is one."""

from __future__ import annotations

import math

from lab.benchmark.arms.base import Answer, Arm, Task
from lab.benchmark.arms.nominal import fitting, refitted

__all__ = ["ARM", "fit"]


def fit(task: Task) -> Answer:
    """The figure that the diagnosis has, else a fit of its own."""
    if math.isfinite(task.refitted_rms):
        return Answer(task.refitted_rms, task.refitted_rms, note="as the diagnosis fitted it")
    with fitting(task) as fitter:
        held = refitted(fitter).held_out_rms
    return Answer(held, held)


ARM = Arm("refitted", "Nominal model refitted", fit)
