"""`MujocoPlant`: a user's MJCF as MuJoCo steps it, with the file's own options.

Timestep, integrator, solver and solref stay as they are. Log samples fall on steps where the sampling time is a multiple of the
timestep; elsewhere outputs are interpolated between steps (`MujocoPlant.interpolates`): angles by the cubic through angles and
velocities, velocities by straight lines, since MuJoCo's acceleration is constant over a step.
"""

from __future__ import annotations

import copy
import itertools
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from mjsim.errors import InputError
from mjsim.mjcf import Model, load_model, write_corrected
from mjsim.mjcf.compile import caught_warnings, compile_file
from mjsim.mjcf.drive_laws import begin, law_of
from mjsim.ode import DivergedError
from mjsim.plant.base import Hold, Linear, Parameter, Signal, Start, as_input, mean_input, signals_of
from mjsim.plant.channels import Channels, find_channels
from mjsim.plant.stepper import Stepper, transition
from mjsim.system import assemble

__all__ = ["MujocoPlant", "run_together"]

CHUNK = 200_000  # steps whose states are kept in memory at once
STEP_US, STAGES = 2.0, {mujoco.mjtIntegrator.mjINT_RK4: 4}  # nominal time of an evaluation [us], evaluations of a step
FLOOR = 1e-5  # error of ties, which MuJoCo holds by soft constraints (docs/decisions/mjcf.md)
EXACT = 1e-6  # of a step, by which a sample may be off it


@dataclass(frozen=True, eq=False)
class MujocoPlant:
    """A compiled model whose bound actuator is the input, and whose driven joint gives velocity and angle.

    Bound sensors are read, with their delays and without their noise; where there are none, qpos and qvel of the driven joint.
    The input is the actuator's ctrl: a torque of motors, the command of servos (position, velocity, general).
    """

    path: Path
    model: mujoco.MjModel
    channels: Channels

    @classmethod
    def load(cls, path: str | Path, *, actuator: str | None = None) -> MujocoPlant:
        """Read an MJCF file; actuator and sensors as bound beside it or in it. Raises InputError."""
        path = Path(path)
        model = compile_file(path)
        return cls(path, model, find_channels(model, path, actuator))

    @property
    def timestep(self) -> float:
        """The file's timestep [s]."""
        return float(self.model.opt.timestep)

    def interpolates(self, dt: float) -> bool:
        """Whether samples of dt [s] fall between steps."""
        return self._steps(dt) is None

    def _steps(self, dt: float) -> int | None:
        ratio = dt / self.timestep
        return round(ratio) if round(ratio) >= 1 and abs(ratio - round(ratio)) < EXACT else None

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The control of the bound actuator."""
        return self._signals[0]

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Velocity and angle of the driven joint."""
        return self._signals[1]

    @cached_property
    def _signals(self) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
        return signals_of(self.channels.joint, self.channels.motion, self.channels.role)

    @cached_property
    def source(self) -> Model | None:
        """The chain that the file is, None where it is none."""
        try:
            return load_model(self.path, actuator=self.channels.actuator_name)
        except InputError:
            return None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the chain that the file is; none where it is no chain."""
        from mjsim.plant.chain import ChainPlant

        return ChainPlant(self.source.axis).parameters if self.source else ()

    @cached_property
    def _fastest(self) -> float:
        """Largest natural frequency or decay rate [rad/s] about the zero position, dry friction and limits left out."""
        m = copy.copy(self.model)
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS | mujoco.mjtDisableBit.mjDSBL_LIMIT
        a, _ = transition(m, mujoco.MjData(m), 1, self.channels.control)
        poles = np.linalg.eigvals(a).astype(complex)
        return float(np.max(np.abs(np.log(np.where(poles == 0.0, 1e-12, poles))))) / self.timestep

    @property
    def tolerance(self) -> float:
        """Error of the integrator on the fastest mode w of the model: w h / 2 of first-order methods, (w h)^4 / 120 of RK4.

        h: timestep. The leading term of the phase error, relative to the angle that the mode turns in 1 / w.
        """
        x = self._fastest * self.timestep
        runge_kutta = int(self.model.opt.integrator) == mujoco.mjtIntegrator.mjINT_RK4
        return max(FLOOR, x**4 / 120.0 if runge_kutta else 0.5 * x)

    def with_values(self, values: Mapping[str, float]) -> MujocoPlant:
        """The file with some parameters replaced, written by `write_corrected` and compiled. Raises KeyError."""
        if self.source is None:
            raise KeyError(f"{self.path.name} is no single-axis chain: it has no parameters")
        axis = self.source.axis.with_values(values)
        with tempfile.TemporaryDirectory() as work:
            written = Path(work) / self.path.name
            write_corrected(self.path, axis, written)
            return MujocoPlant(self.path, compile_file(written), self.channels)

    def run(self, u: np.ndarray, dt: float, *, start: Start | None = None, hold: Hold = Hold.HELD) -> np.ndarray:
        """Outputs (N, 2) of a free run on inputs (N, 1)."""
        return self.run_many([u], dt, [start or Start()], hold=hold)[0]

    def run_many(
        self, inputs: Sequence[np.ndarray], dt: float, starts: Sequence[Start], *, hold: Hold = Hold.HELD, threads: int = 1
    ) -> list[np.ndarray]:
        """Outputs of several runs of equal length at once, by `mujoco.rollout`."""
        us = [as_input(u, 1) for u in inputs]
        if len({len(u) for u in us}) != 1 or len(us) != len(starts):
            raise ValueError(f"{len(us)} inputs of lengths {[len(u) for u in us]} and {len(starts)} starts; expected equal ones")
        n, steps, h = len(us[0]), self._steps(dt), self.timestep
        count = self._count(n, dt)
        held = np.stack([mean_input(u, dt, h, count, hold)[:, 0] for u in us])
        every = np.concatenate(list(self._roll(held, starts, threads, _chunks(count, len(us)))), axis=1)
        if steps:
            return [y[::steps].copy() for y in every]
        return [_between(y, h, dt, 0, n) for y in every]

    def pieces(
        self, u: np.ndarray, dt: float, *, start: Start | None = None, hold: Hold = Hold.HELD, ends: Sequence[int]
    ) -> Iterator[np.ndarray]:
        """Outputs of a free run, piece by piece: samples up to each of ``ends``, the last of which is N. The same as `run` gives.

        A run that has shown enough need not be ended. Raises as `run` does.
        """
        u, steps, h = as_input(u, 1), self._steps(dt), self.timestep
        if not ends or ends[-1] != len(u) or any(a >= b for a, b in itertools.pairwise((0, *ends))):
            raise ValueError(f"pieces end at {list(ends)}; expected rising numbers up to {len(u)}")
        stops: list[int] = []
        for end in ends:  # where samples are shorter than steps, a piece of few samples may need none of its own
            stops.append(max(self._count(end, dt), stops[-1] + 1 if stops else 1))
        held = mean_input(u, dt, h, stops[-1], hold)[None, :, 0]
        every, done = np.empty((stops[-1], 2)), 0
        for a, b, y in zip((0, *ends[:-1]), ends, self._roll(held, [start or Start()], 1, stops), strict=True):
            every[done : done + y.shape[1]] = y[0]
            done += y.shape[1]
            yield every[a * steps : b * steps : steps].copy() if steps else _between(every, h, dt, a, b)

    def _count(self, n: int, dt: float) -> int:
        """Steps that n samples take: whole samples, or up to the step behind the last one."""
        steps = self._steps(dt)
        return n * steps if steps else math.ceil((n - 1) * dt / self.timestep + EXACT) + 1

    def _roll(self, held: np.ndarray, starts: Sequence[Start], threads: int, stops: Sequence[int]) -> Iterator[np.ndarray]:
        """Velocity and angle (R, k, 2) at the beginning of each step on controls (R, M), in pieces that end at ``stops``."""
        m, c = self.model, self.channels
        runs = len(held)
        spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
        size = mujoco.mj_stateSize(m, spec)
        first = [self._data(s, float(u[0])) for s, u in zip(starts, held, strict=True)]
        state = np.empty((runs, size))
        warm: np.ndarray | None = np.array([d.qacc_warmstart for d in first])
        for r, d in enumerate(first):
            mujoco.mj_getState(m, d, state[r], spec)
        data = [mujoco.MjData(m) for _ in range(max(1, min(threads, runs)))]
        for a, b in itertools.pairwise((0, *stops)):
            control = np.zeros((runs, b - a, c.width))
            if c.control >= 0:
                control[:, :, c.control] = held[:, a:b]
            with caught_warnings() as said:
                states, sensors = rollout.rollout(
                    m, data, state, control if c.width else None, nstep=b - a, initial_warmstart=warm
                )
            at = np.concatenate([state[:, None], states[:, :-1]], axis=1)
            out = np.empty((runs, b - a, 2))
            for column, (address, sensor) in enumerate(((1 + m.nq + c.dof, c.velocity), (1 + c.position, c.angle))):
                out[:, :, column] = at[:, :, address] if sensor is None else sensors[:, :, sensor]
            self._check(states, said, data)
            state = states[:, -1].copy()
            warm = np.array([data[0].qacc_warmstart]) if runs == 1 else None  # of more runs it is not known which was where
            yield out

    def _data(self, start: Start, first: float | None = None) -> mujoco.MjData:
        """A state to start from: the driven joint and the deflections as asked, delays and filters at the input before.

        ``first``: the first input, that before it where None.
        """
        m, c = self.model, self.channels
        data = mujoco.MjData(m)
        along = self._along
        data.qpos[:] = m.qpos0 + along * (start.angle - m.qpos0[c.position])
        data.qvel[:] = along * start.velocity
        for to, values in ((data.qpos, start.deflections), (data.qvel, start.rates)):
            k = min(len(values), self._behind.shape[1])
            to[:] += self._behind[:, :k] @ np.array(values[:k])
        a = c.actuator
        if a >= 0:
            integral = self.source.integral_force(start.states) if law_of(m, a).integral and self.source else None
            begin(m, data, a, start.input, start.input if first is None else first, integral=integral)
        for sensor, value in ((c.velocity_id, start.velocity), (c.angle_id, start.angle)):
            if sensor is not None and m.sensor_history[sensor, 0] > 0:
                held = np.full((int(m.sensor_history[sensor, 0]), 1), value)
                mujoco.mj_initSensorHistory(m, data, sensor, None, held, 0.0)
        return data

    @cached_property
    def _along(self) -> np.ndarray:
        """Change of every joint (nv,) per unit of the driven one when nothing deflects."""
        if self.source is None:
            row = np.zeros(self.model.nv)
            row[self.channels.dof] = 1.0
            return row
        found = self.source.found
        ratios = np.array([found.chain.total_ratio(i) for i in range(len(found.chain.bodies))])
        return np.asarray(found.base() @ ratios)

    @cached_property
    def _behind(self) -> np.ndarray:
        """Change of every joint (nv, k) per unit of deflection of each coupling; zero of one that the file does not have."""
        if self.source is None:
            return np.zeros((self.model.nv, 0))
        m, base = self.model, self.source.found.base()
        ratios = [c.ratio for c in self.source.found.chain.couplings]
        unit = [tuple(float(i == j) for i in range(j + 1)) for j in range(len(ratios))]
        columns = [base @ Start(deflections=d).of_bodies(ratios)[0] for d in unit]
        for body in assemble(self.source.axis).chain.bodies[len(ratios) + 1 :]:  # that an effect splits off the last one
            column = np.zeros(m.nv)
            joint = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_JOINT, body.joint)
            if joint >= 0:
                above = int(m.body_jntadr[m.body_parentid[m.jnt_bodyid[joint]]])
                along = base[m.jnt_dofadr[above], -1] if above >= 0 else 1.0
                column[m.jnt_dofadr[joint]] = -1.0 if along >= 0 else 1.0
            columns.append(column)
        return np.column_stack(columns) if columns else np.zeros((m.nv, 0))

    def _check(self, states: np.ndarray, said: list[str], data: Sequence[mujoco.MjData]) -> None:
        """Raise DivergedError with time, element and remedy on a warning, a value that is not finite or a run that stopped."""
        m = self.model
        stopped = np.diff(states[:, :, 0], axis=1) <= 0
        bad = ~np.isfinite(states[:, :, 1:]).all(axis=2)
        warned = any(w.number for d in data for w in d.warning)
        if not (warned or bad.any() or stopped.any()):  # what is said may be of a run in another thread
            return
        line = said[0] if said else "the motion is not finite"
        words = line.replace(".", " ").split()
        dof = next((int(b) for a, b in itertools.pairwise(words) if a == "DOF" and b.isdigit()), None)
        element = f"joint {m.joint(int(m.dof_jntid[dof])).name!r}" if dof is not None and dof < m.nv else "the model"
        when = states[:, :, 0][bad] if bad.any() else states[:, 1:, 0][stopped]
        at = float(line.rsplit("Time = ", 1)[1].rstrip(". ")) if "Time = " in line else float(np.min(when, initial=math.inf))
        raise DivergedError(
            f"{self.path.name}: MuJoCo stopped at {at:.4f} s at {element} ({line.split('. Time')[0].rstrip('.')}); "
            f"use a smaller timestep than {self.timestep:g} s, or correct the stiffness or damping there"
        )

    def inverse(self, y: np.ndarray, dt: float, *, start: Start | None = None) -> np.ndarray:
        """Inputs (N, 1) with which the driven joint has the velocity of y (N, 2) at every next sample.

        Found sample by sample (`Stepper`). Raises ValueError where samples fall between steps or the actuator does not act within
        a sample, DivergedError where no input gives the motion.
        """
        y, steps = as_input(y, 2), self._steps(dt)
        c = self.channels
        if steps is None:
            raise ValueError(f"a sample of {dt:g} s is no multiple of the timestep {self.timestep:g} s")
        if c.actuator < 0:
            raise ValueError("the model has no actuator: no input makes it move")
        if self.model.actuator_history[c.actuator, 0] > 0:
            raise ValueError(f"actuator {c.actuator_name!r} has a delay: its input does not act within a sample")
        start = start or Start(float(y[0, 1]), float(y[0, 0]))
        stepper = Stepper(self.model, self._data(start), c, steps)
        u = np.full((len(y), 1), start.input)
        with caught_warnings() as said:
            for k in range(len(y) - 1):
                u[k] = stepper.land(float(y[k + 1, 0]), float(u[k - 1, 0]) if k else start.input)
                if said:
                    raise DivergedError(f"{self.path.name}: the inverse run diverged at {k * dt:.4f} s ({said[0]})")
        u[-1] = u[-2]
        return u

    def linearised(self, dt: float, *, start: Start | None = None) -> Linear:
        """By central differences of the steps of a sample, about rest; states are positions, velocities, activations."""
        m, c, steps, start = self.model, self.channels, self._steps(dt), start or Start()
        if steps is None or m.actuator_history[:, 0].any() or m.sensor_history[:, 0].any():
            raise ValueError("samples between steps and delays cannot be linearised; choose a multiple of the timestep")
        data = self._data(start)
        if c.control >= 0:
            data.ctrl[c.control] = start.input
        a, b = transition(m, data, steps, c.control)
        out = np.zeros((2, len(a)))
        out[0, m.nv + c.dof] = out[1, c.dof] = 1.0
        return Linear(a, b, out, dt)

    def cost(self, dt: float) -> float:
        """Steps of a sample times the nominal time of one [us]."""
        stages = STAGES.get(mujoco.mjtIntegrator(int(self.model.opt.integrator)), 1)
        return STEP_US * stages * dt / self.timestep


def _chunks(count: int, runs: int) -> list[int]:
    """Steps at which the pieces of so many runs end whose states are kept in memory at once."""
    each = max(1, CHUNK // runs)
    return [*range(each, count, each), count]


def _between(y: np.ndarray, h: float, dt: float, a: int, b: int) -> np.ndarray:
    """Outputs (b - a, 2) at the samples a to b of dt [s] from those (M, 2) at steps of h [s]."""
    t = dt * np.arange(a, b) / h
    k = np.minimum(t.astype(int), len(y) - 2)
    g = t - k
    v0, v1, q0, q1 = y[k, 0], y[k + 1, 0], y[k, 1], y[k + 1, 1]
    a, b, step = h * v0, h * v1, q1 - q0
    angle = q0 + g * (a + g * (3 * step - 2 * a - b + g * (a + b - 2 * step)))
    return np.column_stack([v0 + g * (v1 - v0), angle])


def run_together(jobs: Sequence[tuple[MujocoPlant, np.ndarray, float, Start]], threads: int = 2) -> list[np.ndarray | None]:
    """Free runs of several plants side by side; None for one that diverges."""

    def one(job: tuple[MujocoPlant, np.ndarray, float, Start]) -> np.ndarray | None:
        plant, u, dt, start = job
        try:
            return plant.run(u, dt, start=start)
        except DivergedError:
            return None

    with ThreadPoolExecutor(max(1, threads)) as pool:
        return list(pool.map(one, jobs))
