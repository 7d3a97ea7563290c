"""Plain MuJoCo on the recorded command of a servo, as the command goes between its samples."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from mjsim.hold import within
from mjsim.mujoco_run import run_literal

if TYPE_CHECKING:
    from mjsim.mjcf import Model
    from mjsim.ode import Trajectory
    from mjsim.plant import Start
    from mjsim.recording import Recording

__all__ = ["finer", "literal_servo_run", "sampled"]


def literal_servo_run(source: Model, recording: Recording, begin: Start | None = None) -> Trajectory:
    """Run of a servo's MJCF by MuJoCo from a start; arrays (N,) at the recorded samples.

    ``begin``: where it starts, at rest at the angle that was measured first where None.
    A command that is not held is held over each step of MuJoCo, at its mean there. Raises DivergedError.
    """
    chain, r = source.axis.chain, recording
    start = np.zeros((2, len(chain.bodies)))
    first = 0.0 if r.angle is None else float(r.angle[0])
    start[0] = [first * chain.total_ratio(i) for i in range(len(chain.bodies))]
    if begin is not None:
        start, source = (
            begin.of_bodies([c.ratio for c in chain.couplings]),
            dataclasses.replace(source, axis=source.axis.started(begin.states)),
        )
    before = float(r.input[0])
    if r.hold == "held":
        return run_literal(source, r.input, r.dt, initial=start, before=before, known=r.known_torque)
    each = max(1, math.ceil(r.dt / float(source.mjmodel.opt.timestep) - 1e-6))
    fine = within(r.input, r.dt, r.hold, each)
    known = None if r.known_torque is None else finer(r.known_torque, each)
    return sampled(run_literal(source, fine, r.dt / each, initial=start, before=before, known=known), each)


def finer(known: np.ndarray, each: int) -> np.ndarray:
    """A known torque (N,) at ``each`` times as many samples, in straight lines between those that there are."""
    return np.asarray(np.interp(np.arange(len(known) * each) / each, np.arange(len(known)), known))


def sampled(run: Trajectory, each: int) -> Trajectory:
    """Every so-manyth sample of a run."""
    names = ("time", "torque", "velocity", "angle", "q", "v", "coupling_torque")
    return dataclasses.replace(run, **{name: getattr(run, name)[::each].copy() for name in names})
