"""`ChainPlant`: the analytic equations of a chain, integrated by the compiled kernel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mjsim import ode
from mjsim.axis import Axis
from mjsim.plant.base import Hold, Linear, Parameter, Signal, Start, as_input, mean_input, signals_of
from mjsim.system import System, assemble

__all__ = ["ChainPlant"]

FINE = 8  # parts of a sample in which an input that is not held is laid out as held: its error falls with their square
STEP_US = 0.1  # a Runge-Kutta step of the compiled kernel [us] (lab/speed/mjsim_speed.py)
SMALL = 1e-6  # step of central differences, in radians and radians per second (metres): error 1e-12 of a smooth law
AFFINE = 1e-5  # error of the kernel on a chain that is affine between events (docs: simgap crosscheck)


@dataclass(frozen=True)
class ChainPlant:
    """An axis (chain and effects) as a plant with one input and the outputs velocity and angle of its driven body."""

    axis: Axis

    @cached_property
    def _system(self) -> System:
        return assemble(self.axis)

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The commanded torque."""
        return self._signals[0]

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Velocity and angle of the driven body, sensor effects included."""
        return self._signals[1]

    @cached_property
    def _signals(self) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
        chain = self.axis.chain
        return signals_of(chain.bodies[0].joint, chain.motion, "torque")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Linear parameters by name, those of effects as ``id@place.name``."""
        motion = self.axis.chain.motion
        linear = [Parameter(p.name, p.value, p.quantity.unit(motion)) for p in self.axis.chain.linear_parameters()]
        return (
            *linear,
            *(Parameter(f"{e.key}.{s.name}", e.values[s.name], s.unit(motion)) for e in self.axis.effects for s in e.specs()),
        )

    @property
    def tolerance(self) -> float:
        """The largest that its effects declare, at least that of the kernel on an affine chain."""
        return max([AFFINE, *(e.tolerance for e in self.axis.effects)])

    def with_values(self, values: Mapping[str, float]) -> ChainPlant:
        """A copy with some parameters replaced."""
        return ChainPlant(self.axis.with_values(values))

    def _initial(self, start: Start) -> np.ndarray:
        return start.of_bodies(self._system.f[2, :-1].tolist())

    def run(self, u: np.ndarray, dt: float, *, start: Start | None = None, hold: Hold = Hold.HELD) -> np.ndarray:
        """Outputs (N, 2) of a free run on inputs (N, 1)."""
        u, start = as_input(u, 1), start or Start()
        parts = FINE if hold is Hold.LINEAR else 1
        fine = mean_input(u, dt, dt / parts, len(u) * parts, hold)[:, 0]
        out = ode.simulate(self._system, fine, dt / parts, initial=self._initial(start), before=start.input)
        return np.column_stack([out.velocity, out.angle])[::parts]

    def inverse(self, y: np.ndarray, dt: float, *, start: Start | None = None) -> np.ndarray:
        """Inputs (N, 1) along a motion (N, 2): exact to the second order of dt, in the mean over each sample."""
        y = as_input(y, 2)
        v = 0.5 * (y[1:, 0] + y[:-1, 0])
        q = 0.5 * (y[1:, 1] + y[:-1, 1])
        u = ode.inverse(self._system, q, v, np.diff(y[:, 0]) / dt, dt)
        return np.append(u, u[-1])[:, None]

    def linearised(self, dt: float, *, start: Start | None = None) -> Linear:
        """By central differences of a run over one sample, about rest at an angle; states are angles, then velocities."""
        s, n, start = self._system, self._system.n, start or Start()
        if s.n_states or s.input_lag or s.input_delay or s.output_lag or s.output_delay:
            raise ValueError("the axis has hidden states (bristles, delays, lags); leave those effects out to linearise it")
        rest = np.zeros((2, n))
        rest[:] = self._initial(start)

        def after(state: np.ndarray, torque: float) -> np.ndarray:
            out = ode.simulate(s, np.full(2, torque), dt, initial=state)
            return np.concatenate([out.q[1], out.v[1]])

        columns = []
        for i in range(2 * n):
            shift = np.zeros(2 * n)
            shift[i] = SMALL
            ahead, behind = (after(rest + sign * shift.reshape(2, n), start.input) for sign in (1, -1))
            columns.append((ahead - behind) / (2 * SMALL))
        b = (after(rest, start.input + SMALL) - after(rest, start.input - SMALL)) / (2 * SMALL)
        c = np.zeros((2, 2 * n))
        c[0, n] = c[1, 0] = 1.0
        return Linear(np.column_stack(columns), b[:, None], c, dt)

    def cost(self, dt: float) -> float:
        """Kernel steps of a sample times the nominal time of one [us]."""
        steps, parts = self._system.steps(dt, 0.0)
        return STEP_US * steps * parts
