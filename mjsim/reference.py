"""The exact reference: piecewise-affine flow with located events, for the effects that are affine between events.

Between events the axis obeys y' = A y with y = (q, v, lagged input, sensor lags, held input, 1), whose flow is the matrix
exponential. It is summed here as the power series of exp(A s) y, so that every event function is a polynomial in s whose
first root is bracketed and bisected to rounding. No step size enters: this is another algorithm than `mjsim.kernel` (RK4 with
secants), and what both are measured against. Coulomb, static and asymmetric friction, offsets, gaps under each law, further
modes, input and output maps, lags and delays are of this class, in any combination.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mjsim import affine
from mjsim.axis import Axis
from mjsim.effects import ports as P  # noqa: N812
from mjsim.effects.base import need_torque_input
from mjsim.law_probes import constant
from mjsim.ode import DivergedError, Trajectory, apply_input
from mjsim.system import System, assemble, state_matrix

__all__ = ["NotAffineError", "not_affine", "simulate"]


class NotAffineError(ValueError):
    """The axis has an effect that is not affine between events: the exact reference does not cover it."""


def not_affine(axis: Axis) -> str | None:
    """Why the exact reference does not cover this axis (one line), or None when it does."""
    if axis.chain.bodies[0].limit is not None:
        return "the limits of the driven joint are not affine"
    for effect in axis.effects:
        for port in effect.ports(axis.chain):
            if isinstance(port, P.Friction):
                if axis.chain.bodies[port.body].softness is not None:
                    return f"{effect.key} is soft"
                if constant(port.law, port.p, 1.0) is None or constant(port.law, port.p, -1.0) is None:
                    return f"the friction level of {effect.key} varies while it slides or sticks"
            elif isinstance(port, P.BodyTorque):
                if port.state or constant(port.law, port.p, 1.0) is None:
                    return f"the torque of {effect.key} is not constant"
            elif isinstance(port, P.CouplingTorque | P.Twist | P.BodyInertia | P.JointLimit):
                return f"{effect.key} is not affine"
    return None


def _constants(axis: Axis, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 4) sliding level forward, backward, breakaway level forward, backward; (n) constant torques."""
    levels, torque = np.zeros((n, 4)), np.zeros(n)
    for effect in axis.effects:
        for port in effect.ports(axis.chain):
            if isinstance(port, P.Friction):
                forward, backward = constant(port.law, port.p, 1.0), constant(port.law, port.p, -1.0)
                assert forward is not None
                assert backward is not None
                levels[port.body] += (forward[0], backward[0], forward[1], backward[1])
            elif isinstance(port, P.BodyTorque):
                value = constant(port.law, port.p, 1.0)
                assert value is not None
                torque[port.body] += value[0]
    return levels, torque


def simulate(
    axis: Axis, torque: np.ndarray, dt: float, *, initial: np.ndarray | None = None, t0: float = 0.0, before: float = 0.0
) -> Trajectory:
    """Free-run a piecewise-affine axis exactly on a commanded torque (N,) held over each sample of dt [s].

    ``initial`` (2, n): angles and velocities at the start, at rest when None; ``before``: commanded torque ahead of the
    first sample. Raises NotAffineError when an effect is not of the class, DivergedError when the run leaves the finite numbers,
    NotApplicableError for a servo.
    """
    need_torque_input(axis.chain)
    reason = not_affine(axis)
    if reason is not None:
        raise NotAffineError(reason)
    s: System = assemble(axis)
    n, count = s.n, len(torque)
    levels, torques = _constants(axis, n)
    u = np.array(apply_input(s, np.asarray(torque, float)), float)
    x0 = s.initial(initial)
    shift, split = _parts(s.input_delay / dt)
    back = math.ceil(s.output_delay / dt - 1e-9)
    late = max(0.0, back - s.output_delay / dt)
    fastest = float(np.max(np.abs(np.linalg.eigvals(state_matrix(s.f)))))
    rates = [fastest, *(1 / tau for tau in (s.input_lag, s.output_lag) if tau > 0)]
    n_sub = max(1, math.ceil(dt * max(rates)))
    out, mid = np.empty((count, 2 * n + 2 + n - 1)), np.empty((count, 2 * n + 2))
    flow = (s.f, s.gap_law, s.chain.gain, s.input_lag, s.output_lag, levels, torques)
    status, at = affine.run(flow, s.has_friction, u, dt, shift, split, float(before), late, n_sub, x0, out, mid)
    if status:
        what = "diverged" if status == 1 else f"met more than {affine.MAX_EVENTS} events within one sample"
        raise DivergedError(f"the exact reference {what} at {t0 + at * dt:.4f} s (body {s.chain.bodies[0].joint!r})")
    time = t0 + dt * np.arange(count)
    column = 2 * n if s.output_lag > 0 else 0
    measured: list[Any] = []
    for c in (column + (1 if s.output_lag > 0 else n), column):
        if back == 0:
            measured.append(out[:, c].copy())
        else:
            seen = mid[:, c] if late > 0 else out[:, c]
            measured.append(np.concatenate([np.full(min(back, count), out[0, c]), seen[: max(count - back, 0)]]))
    velocity, angle = measured
    for m in s.output_maps:
        velocity = m.map.apply(velocity, m.c)
    return Trajectory(
        time, np.array(torque, float), velocity, angle, out[:, :n].copy(), out[:, n : 2 * n].copy(), out[:, 2 * n + 2 :].copy()
    )


def _parts(delay: float) -> tuple[int, float]:
    """Whole samples and the fraction of one, with rounding kept out of the fraction."""
    whole = math.floor(delay + 1e-12)
    part = max(0.0, delay - whole)
    return whole, part if part >= 1e-9 else 0.0
