"""Free runs of a model as a recording drives it."""

from __future__ import annotations

from typing import Any

import numpy as np

from diagnose.data.experiment import Experiment, measured_velocity
from mjsim.axis import Axis
from mjsim.known_torque import KnownTorque
from mjsim.ode import Trajectory, simulate

__all__ = ["free_run", "with_known"]


def free_run(axis: Axis, experiment: Experiment, initial: np.ndarray | None = None, **how: Any) -> Trajectory:
    """Free run on the input of a recording, as the input is held there; a servo's starts at the angle that was measured first.

    ``initial`` (2, n): angles and velocities at the start, relative to that angle. Raises DivergedError.
    """
    r = experiment.recording
    axis = with_known(axis, experiment)
    chain = axis.chain
    angle, origin = r.angle, None if initial is None or r.angle is None else experiment.angle
    if chain.servo is not None:
        initial = np.zeros((2, len(chain.bodies))) if initial is None else np.array(initial, float)
        last = len(chain.bodies) - 1  # a body that an effect adds goes with it
        initial[0] += [experiment.angle * chain.total_ratio(min(i, last)) for i in range(initial.shape[1])]
        angle = None  # under its own servo a model does not drift from the angle that laws are locked to
        how |= {"speed": float(np.max(np.abs(measured_velocity(r))))}
    how |= {"initial": initial, "angle": angle, "origin": origin, "before": experiment.before, "hold": r.hold}
    return simulate(axis, r.input, r.dt, **how)


def with_known(axis: Axis, experiment: Experiment) -> Axis:
    """The axis with the torque on it that a recording knows sample by sample."""
    known = experiment.recording.known_torque
    if known is None:
        return axis
    return axis + KnownTorque.of(known, experiment.recording.dt)
