"""Many runs at once: every axis on every input, on all cores, bit for bit what they give one by one."""

from __future__ import annotations

import enum
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjsim.axis import Axis
from mjsim.mjcf.compile import caught_warnings
from mjsim.ode import DivergedError, Trajectory
from mjsim.system import assemble

__all__ = ["Drive", "Engine", "rollout"]


class Engine(enum.Enum):
    """What runs an axis."""

    ODE = "ode"
    ACCURATE = "accurate"
    REFERENCE = "reference"


@dataclass(frozen=True)
class Drive:
    """An input: torque (N,) held over each sample of dt [s], and the motion it starts from (2, n), at rest when None."""

    torque: np.ndarray
    dt: float
    initial: np.ndarray | None = None


def rollout(
    axes: Sequence[Axis], drives: Sequence[Drive], *, engine: Engine = Engine.ODE, threads: int | None = None
) -> list[list[Trajectory | DivergedError]]:
    """Run every axis on every drive: ``out[a][d]`` is the trajectory, or the DivergedError that ended it.

    The runs share nothing and the compiled engines hold no lock, so ``threads`` (all cores when None) work side by side.
    """
    run = _runner(engine)
    # laws compile here, once, and not in the threads
    ready: list[Any] = [axis if engine is Engine.REFERENCE else assemble(axis) for axis in axes]
    jobs = [(model, drive) for model in ready for drive in drives]

    def one(job: tuple[Any, Drive]) -> Trajectory | DivergedError:
        model, drive = job
        try:
            return run(model, drive.torque, drive.dt, initial=drive.initial)
        except DivergedError as error:
            return error

    with caught_warnings():
        if jobs:
            one((jobs[0][0], Drive(jobs[0][1].torque[:2], jobs[0][1].dt)))  # load the compiled engine before the threads want it
        with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
            done = list(pool.map(one, jobs))
    width = len(drives)
    return [done[a * width : (a + 1) * width] for a in range(len(axes))]


def _runner(engine: Engine) -> Callable[..., Trajectory]:
    if engine is Engine.ACCURATE:
        from mjsim import accurate

        return accurate.simulate
    if engine is Engine.REFERENCE:
        from mjsim import reference

        return reference.simulate
    from mjsim import ode

    return ode.simulate
