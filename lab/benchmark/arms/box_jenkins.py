"""The black-box ceiling: a Box-Jenkins model of torque to velocity, by the better pipeline of `simgap study`.

Decimated by five through the shared filter, orders [7 5 5 6 0], simulation focus. It is judged by simulation on the held-out
recording at the same rate, its initial state fitted there (MATLAB ``compare``). What it leaves on the estimation recording no
linear model explains; held out, it pays besides for every frequency that the estimation recording did not reach.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lab.benchmark.arms.base import Answer, Arm, Task
from lab.benchmark.arms.nominal import fitting, refitted
from lab.study.pipeline import BETTER, Pipeline
from mjsim.errors import InputError
from mjsim.recording import Recording

__all__ = ["ARM", "fit", "noise_gain"]


def noise_gain(pipeline: Pipeline) -> float:
    """Rms of unit white noise after the zero-phase decimation: sqrt(mean |H|^4), H the filter run once."""
    from scipy.signal import sosfreqz

    from ident import Decimation

    if pipeline.decimate == 1:
        return 1.0
    _, h = sosfreqz(Decimation(pipeline.decimate).sections(), worN=1 << 16)
    return float(np.sqrt(np.mean(np.abs(h) ** 4)))


def _velocity(recording: Recording) -> np.ndarray:
    if recording.velocity is None:
        raise InputError(recording.source, "no velocity", "a velocity channel")
    return recording.velocity


def fit(task: Task) -> Answer:
    """Identify on the estimation recording, simulate the held-out one."""
    from ident import simulated

    e, h = task.estimation, task.held_out
    mine = BETTER.prepare(e.torque, _velocity(e), e.dt, e.source)
    model = BETTER.fit(mine).model
    data = BETTER.prepare(h.torque, _velocity(h), h.dt, h.source)
    with fitting(task) as fitter:
        nominal = refitted(fitter).on_held_out
    rival = BETTER.prepare(h.torque, nominal, h.dt, h.source)
    left, left_nominal = data.y - simulated(model, data), data.y - rival.y
    own = _rms(mine.y - simulated(model, mine))
    note = f"{1 / data.dt:.0f} Hz, orders {list(BETTER.orders)}, {own:.4g} rad/s on the estimation recording"
    return Answer(_rms(left), _rms(left_nominal), noise_gain(replace(BETTER, low_pass=False)), note=note)


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


ARM = Arm("box_jenkins", "Box-Jenkins black box, decimated", fit)
