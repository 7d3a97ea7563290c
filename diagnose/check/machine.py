"""What the checks need of a nominal model: modes, driving-point impedance, nominal friction and gravity, gear ratios, range."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mjsim.axis import Axis, Chain
from mjsim.chain import Limit
from mjsim.effects import ports as P  # noqa: N812
from mjsim.effects.law import ANGLE, DIRECTION, N_LOCAL, POSITION, RATE
from mjsim.mjcf import Model
from mjsim.mjcf.joint_limit import limit_of
from mjsim.quantity import Motion

__all__ = ["Machine"]

DAMPED = 0.3  # of the fixed denominator: wide enough that a mode which is 20 % off is still within its half-width
_GRID = 721  # points of the angle at which the position torque is tabulated: half a degree over one turn


@dataclass(frozen=True, eq=False)
class Machine:
    """A nominal axis as the checks see it.

    range: (low, high) of the driven joint [rad | m] or None; limit: how MuJoCo holds it there, None where no law stands for that.
    """

    axis: Axis
    range: tuple[float, float] | None = None
    limit: Limit | None = None

    @classmethod
    def of(cls, model: Model | Axis) -> Machine:
        """From a loaded model, with the range of its driven joint, or from an axis."""
        if isinstance(model, Axis):
            return cls(model)
        name, mj = model.axis.chain.bodies[0].joint, model.mjmodel
        if name.startswith("#") or not mj.jnt_limited[mj.joint(name).id]:
            return cls(model.axis)
        low, high = mj.jnt_range[mj.joint(name).id]
        return cls(model.axis, (float(low), float(high)), limit_of(model))

    def yields(self, speed: float, torque: float) -> float:
        """How far MuJoCo lets the driven joint past its range [rad | m], at most: met at a speed, and pressed by a torque.

        By d (K d r + B v) + (1 - d) a = 0, with a = torque / J: v / sqrt(K) / d without damping and (1 - d) a / (K d^2) at rest.
        """
        if self.limit is None:
            return 0.0
        d = min(self.limit.impedance[:2])
        pressed = (1.0 - d) * torque / self.chain.bodies[0].inertia / (self.limit.stiffness * d**2)
        return speed / (d * math.sqrt(self.limit.stiffness)) + pressed

    @property
    def chain(self) -> Chain:
        """The chain of the axis."""
        return self.axis.chain

    @property
    def hinge(self) -> bool:
        """Whether the driven joint turns."""
        return self.chain.motion is Motion.HINGE

    @property
    def ratios(self) -> np.ndarray:
        """Motion (n,) of each body per motion of the driven one, undeflected."""
        return np.array([self.chain.total_ratio(i) for i in range(len(self.chain.bodies))])

    @cached_property
    def inertia(self) -> float:
        """Sum J_i r_i^2 at the driven body [kg m^2 | kg]."""
        return float(sum(b.inertia * r**2 for b, r in zip(self.chain.bodies, self.ratios, strict=True)))

    @cached_property
    def viscous(self) -> float:
        """Sum f_i r_i^2 at the driven body [N m s/rad | N s/m]."""
        return float(sum(b.viscous * r**2 for b, r in zip(self.chain.bodies, self.ratios, strict=True)))

    @cached_property
    def gears(self) -> tuple[float, ...]:
        """Ratios > 1 between two sides of a gear: the actuator's gain, and the chain's couplings."""
        found = {abs(self.chain.gain)} | {abs(float(r)) for r in self.ratios}
        large = sorted(max(g, 1 / g) for g in found if g > 0)
        return tuple(dict.fromkeys(round(g, 9) for g in large if g > 1.0 + 1e-9))

    @cached_property
    def modes(self) -> tuple[float, ...]:
        """Frequencies of the free chain [Hz], rising, without the rigid motion."""
        return self._frequencies(0)

    @cached_property
    def locked_modes(self) -> tuple[float, ...]:
        """Frequencies of the chain with the driven body held [Hz]: where the driving-point impedance has its poles."""
        return self._frequencies(1)

    def _frequencies(self, first: int) -> tuple[float, ...]:
        n = len(self.chain.bodies)
        if n - first < 1 or n == 1:
            return ()
        K = np.zeros((n, n))
        for j, c in enumerate(self.chain.couplings):
            row = np.zeros(n)
            row[j], row[j + 1] = c.ratio, -1.0
            K += c.stiffness * np.outer(row, row)
        scale = 1 / np.sqrt([b.inertia for b in self.chain.bodies])
        values = np.linalg.eigvalsh((scale[:, None] * K * scale)[first:, first:])
        return tuple(float(math.sqrt(w) / (2 * math.pi)) for w in values if w > 1e-9 * max(values[-1], 1e-300))

    @cached_property
    def shape_size(self) -> int:
        """Number of parameters that shape the impedance: J, k, d behind the driven body, and the driven inertia; 0 for one
        body."""
        n = len(self.chain.bodies)
        return 0 if n == 1 else n + 2 * (n - 1)

    def impedance(self, frequency: np.ndarray, shape: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Driving-point impedance N / D, without viscous friction to ground, as (N, D) (F,) over one fixed denominator.

        Z = det(M s^2 + C s + K) / (s det of the part behind the driven body), in units of the input per velocity. Both are
        divided by prod(s^2 + 2 DAMPED w_i s + w_i^2) over the nominal locked modes, so that they are smooth for any parameters.
        ``shape``: logarithms of factors on J (n), k (n - 1), d (n - 1).
        """
        n, s = len(self.chain.bodies), 2j * math.pi * np.asarray(frequency, float)
        factor = np.exp(np.zeros(self.shape_size) if shape is None else shape)
        if n == 1:
            return self.inertia * s / self.chain.gain, np.ones(len(s), complex)
        A = np.zeros((len(s), n, n), complex)
        for i, body in enumerate(self.chain.bodies):
            A[:, i, i] += factor[i] * body.inertia * s**2
        for j, c in enumerate(self.chain.couplings):
            row = np.zeros(n)
            row[j], row[j + 1] = c.ratio, -1.0
            A += (factor[n + j] * c.stiffness + factor[2 * n - 1 + j] * c.damping * s)[:, None, None] * np.outer(row, row)
        w = 2 * math.pi * np.array(self.locked_modes)
        fixed = np.prod(s[:, None] ** 2 + 2 * DAMPED * w * s[:, None] + w**2, axis=1)
        fixed *= math.prod(b.inertia for b in self.chain.bodies[1:])
        return np.linalg.det(A) / (s * fixed * self.chain.gain), np.linalg.det(A[:, 1:, 1:]) / fixed

    def friction(self, velocity: np.ndarray) -> np.ndarray:
        """Nominal friction (N,) at a velocity of the driven body (N,), opposing it, in units of the input."""
        out = self.viscous * velocity
        for i, r in enumerate(self.ratios):
            for port in self._frictions(i):
                out = out + np.sign(velocity) * abs(r) * self._levels(port, np.abs(r * velocity))
        return np.asarray(out) / self.chain.gain

    def gravity(self, angle: np.ndarray) -> np.ndarray | None:
        """Nominal torque (N,) that holds the axis at an angle (N,), in units of the input; None when the model has none."""
        out = np.zeros(len(angle))
        for i, r in enumerate(self.ratios):
            for port in self._torques(i):
                grid = np.linspace(float(np.min(r * angle)), float(np.max(r * angle)) + 1e-12, _GRID)
                out -= r * np.interp(r * angle, grid, [self._at(port, x) for x in grid])
        return None if np.ptp(out) == 0 else out / self.chain.gain

    def _frictions(self, body: int) -> list[P.Friction]:
        return [p for e in self.axis.effects for p in e.ports(self.chain) if isinstance(p, P.Friction) and p.body == body]

    def _torques(self, body: int) -> list[P.BodyTorque]:
        found = [p for e in self.axis.effects for p in e.ports(self.chain) if isinstance(p, P.BodyTorque)]
        return [p for p in found if p.body == body and not p.state]

    @staticmethod
    def _at(port: P.BodyTorque, angle: float) -> float:
        z, out = [0.0] * N_LOCAL, [0.0] * 3
        z[ANGLE] = z[POSITION] = angle
        port.law(z, port.p, out)
        return float(out[0])

    @staticmethod
    def _levels(port: P.Friction, speed: np.ndarray) -> np.ndarray:
        grid = np.linspace(0.0, float(np.max(speed)) + 1e-12, 41)
        levels = []
        for v in grid:
            z, out = [0.0] * N_LOCAL, [0.0] * 3
            z[RATE], z[DIRECTION] = v, 1.0
            port.law(z, port.p, out)
            levels.append(float(out[0]))
        level: np.ndarray = np.interp(speed, grid, levels)
        return level

    def input_lag(self) -> float:
        """Lag and delay [s] that the model has itself between command and motion, sensors included."""
        total = 0.0
        for effect in self.axis.effects:
            for port in effect.ports(self.chain):
                if isinstance(port, P.InputLag | P.OutputLag):
                    total += port.time_constant
                elif isinstance(port, P.InputDelay | P.OutputDelay):
                    total += port.delay
        return total
