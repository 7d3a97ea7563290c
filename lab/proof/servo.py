"""A position servo around an axis: the model in the loop, as the machine was."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from mjsim.axis import Axis
from mjsim.ode import simulate
from mjsim.system import assemble

__all__ = ["Servo", "ServoRun", "close_position_loop"]


@dataclass(frozen=True)
class Servo:
    """u = kv (kp (reference - position) - velocity) + added, held over a sample; the velocity is the backward difference.

    kp [1/s], kv [V s/m]: gains; drive [N/V]: force per unit of u; limit [V]: of u.
    """

    kp: float
    kv: float
    drive: float
    limit: float


@dataclass(frozen=True)
class ServoRun:
    """Simulated position [m], velocity [m/s] and force [N] at the samples, each (N,)."""

    position: np.ndarray
    velocity: np.ndarray
    force: np.ndarray


def close_position_loop(axis: Axis, servo: Servo, reference: np.ndarray, added: np.ndarray, dt: float, start: float) -> ServoRun:
    """Run the axis under the servo from rest at ``start`` along a reference (N,); ``added`` (N,) comes on top of the command.

    Closed over the analytic ODE, sample by sample.
    """
    # one sample at a time, plain Runge-Kutta costs less than setting up propagators
    system = dataclasses.replace(assemble(axis), affine=False)
    n = len(reference)
    q, v, force = np.empty(n), np.empty(n), np.empty(n)
    state, before = np.array([[start], [0.0]]), start
    for k in range(n):
        q[k], v[k] = state[0, 0], state[1, 0]
        u = servo.kv * (servo.kp * (reference[k] - q[k]) - (q[k] - before) / dt) + added[k]
        force[k] = servo.drive * min(max(u, -servo.limit), servo.limit)
        run = simulate(system, np.full(2, force[k]), dt, initial=state, before=force[k], substeps=1)
        before, state = q[k], np.array([[run.q[1, 0]], [run.v[1, 0]]])
    return ServoRun(q, v, force)
