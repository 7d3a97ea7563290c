"""Steps of a model from one state again and again: the inverse of a run, and its linear model by differences."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjsim.ode import DivergedError
from mjsim.plant.channels import Channels

__all__ = ["Stepper", "transition"]

DOUBLINGS = 60  # of a step that brackets a root: 1e18 times the first one
SMALL = 1e-6  # step of central differences: their error is 1e-12 of a smooth law
CLOSE = 1e-12  # relative to the velocities, to which a sample lands on the one that is asked for


class Stepper:
    """Steps a model over a sample again and again from one state until its end is as asked, then goes on from there."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, channels: Channels, steps: int) -> None:
        self.model, self.data, self.channels, self.steps = model, data, channels, steps
        self.spec = mujoco.mjtState.mjSTATE_INTEGRATION
        self.state = np.empty(mujoco.mj_stateSize(model, self.spec))
        mujoco.mj_getState(model, data, self.state, self.spec)
        self.slope = 0.0  # of the velocity over the input, at the last sample

    def after(self, u: float) -> float:
        """Velocity of the driven joint after a sample with input u."""
        mujoco.mj_setState(self.model, self.data, self.state, self.spec)
        self.data.ctrl[self.channels.control] = u
        mujoco.mj_step(self.model, self.data, self.steps)
        return float(self.data.qvel[self.channels.dof])

    def land(self, target: float, guess: float) -> float:
        """Input, near ``guess``, with which a sample ends at a velocity ``target``.

        The velocity rises with the input; where it does not answer (at rest in dry friction) the guess is
        returned. Raises DivergedError.
        """
        close = CLOSE * max(abs(target), 1e-3)
        u, error = guess, self.after(guess) - target
        if abs(error) > close and self.slope:
            u = guess - error / self.slope
            error = self.after(u) - target
        if abs(error) > close:
            u = self._root(target, guess, close)
        if not math.isfinite(self.after(u)):
            raise DivergedError("the inverse run diverged")
        mujoco.mj_getState(self.model, self.data, self.state, self.spec)
        return u

    def _root(self, target: float, guess: float, close: float) -> float:
        from scipy.optimize import brentq

        near, error = guess, self.after(guess) - target
        step = -error / self.slope if self.slope else math.copysign(1e-3, -error)
        for _ in range(DOUBLINGS):
            far = near + step
            other = self.after(far) - target
            if not math.isfinite(other):
                raise DivergedError("the inverse run diverged")
            if other != error:
                self.slope = (other - error) / (far - near)
            if abs(other) <= close:
                return far
            if error * other < 0:
                return float(brentq(lambda u: self.after(u) - target, near, far, xtol=1e-14, rtol=1e-14))
            near, error, step = far, other, 2.0 * step
        raise DivergedError("no input gives the velocity that is asked for within a sample")


def transition(model: mujoco.MjModel, data: mujoco.MjData, steps: int, control: int) -> tuple[np.ndarray, np.ndarray]:
    """a (s, s), b (s, 1) of the state (positions, velocities, activations) after some steps, by differences about ``data``.

    Central differences, for joints with one coordinate each. `mujoco.mjd_transitionFD` does not do RK4.
    """
    spec = mujoco.mjtState.mjSTATE_INTEGRATION
    kept = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, data, kept, spec)
    parts = (data.qpos, data.qvel, data.act)

    def after(part: np.ndarray, index: int, shift: float) -> np.ndarray:
        mujoco.mj_setState(model, data, kept, spec)
        part[index] += shift
        mujoco.mj_step(model, data, steps)
        return np.concatenate(parts)

    def column(part: np.ndarray, index: int) -> np.ndarray:
        slope: np.ndarray = (after(part, index, SMALL) - after(part, index, -SMALL)) / (2 * SMALL)
        return slope

    a = np.column_stack([column(part, i) for part in parts for i in range(len(part))])
    return a, (column(data.ctrl, control) if control >= 0 else np.zeros(len(a)))[:, None]
