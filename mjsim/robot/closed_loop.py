"""All joints of a robot together in MuJoCo, with the file's own options, along a recording.

Servos are driven by the recorded commands. A joint that is driven by a torque gets the logged one and a tracking loop beside it, since
torques alone drift; what the loop has to give is the error of the model as a torque. Joints that are not in the log are held where they
are. The timestep is the file's, or the next smaller one that divides the sample time.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjsim.hold import between
from mjsim.robot.carried import act, slots_by_joint
from mjsim.robot.drives import joint_drives
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.servo import Target

__all__ = ["ClosedLoop", "closed_loop"]

TRACKING = 2.0  # [Hz]: bandwidth of the tracking loop of joints that are driven by a torque


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """One run: position and velocity (N, m), torque (N, m) of the tracking loop (NaN at servos), and the effects that were left out."""

    z: np.ndarray
    dz: np.ndarray
    tracking: np.ndarray
    lacking: tuple[str, ...]

    @property
    def diverged(self) -> bool:
        """Whether the run left finite numbers."""
        return not bool(np.isfinite(self.z).all())


@dataclass(eq=False)
class _Inputs:
    """Targets of the servos (m,) and torques of the other actuators at any time."""

    robot: Robot
    first: np.ndarray
    slope: np.ndarray
    dt: float

    def at(self, t: np.ndarray) -> np.ndarray:
        """Inputs (m,), each at its own time (m,) [s]."""
        x = np.clip(t / self.dt, 0.0, len(self.first) - 1)
        k = x.astype(int)
        each = np.arange(len(x))
        return np.asarray(self.first[k, each] + self.slope[k, each] * (x - k) * self.dt)


def _inputs(robot: Robot, r: RobotRecording) -> _Inputs:
    drives = joint_drives(robot)
    first, slope = (np.zeros((len(r), len(robot.joints))) for _ in range(2))
    for j, name in enumerate(robot.joints):
        if name not in r.joints:
            continue
        k = r.joints.index(name)
        channel = "torque" if drives[j] is None else "command"
        if r.has(channel, name):
            values = getattr(r, channel)[:, k]
            first[:, j], slope[:, j] = between(values, r.dt, r.hold)
    return _Inputs(robot, first, slope, r.dt)


def closed_loop(
    robot: Robot, recording: RobotRecording, effects: Sequence[Mapping[str, Any]] = (), samples: int | None = None
) -> ClosedLoop:
    """Run all joints along a recording, or its first ``samples``, with the effects that a corrected file carries."""
    model, data = copy.copy(robot.model), mujoco.MjData(robot.model)
    r, n = recording, samples or len(recording)
    each = max(1, math.ceil(r.dt / float(model.opt.timestep) - 1e-6))
    h = r.dt / each
    model.opt.timestep = h
    slots, lacking = slots_by_joint(effects, robot)
    run = _Run(robot, model, data, r, slots, h)
    z, dz, tracking = (np.full((n, len(robot.joints)), np.nan) for _ in range(3))
    for k in range(n):
        z[k], dz[k], tracking[k] = run.position(), run.velocity(), run.given()
        if not np.isfinite(z[k]).all() or np.max(np.abs(dz[k])) > 1e6:
            z[k:] = np.nan
            break
        if k + 1 < n:
            for i in range(each):
                run.step(k * r.dt + (i + 0.5) * h, k)
    return ClosedLoop(z, dz, tracking, lacking)


class _Run:
    """MuJoCo's state along a recording, and what acts on it at each step."""

    def __init__(
        self, robot: Robot, model: mujoco.MjModel, data: mujoco.MjData, r: RobotRecording, slots: np.ndarray, h: float
    ) -> None:
        self.robot, self.model, self.data, self.slots, self.h = robot, model, data, slots, h
        self.drives = joint_drives(robot)
        self.lead = np.array([robot.leading(j) for j in range(len(robot.joints))])
        self.actuators = _actuators(robot)
        self.inputs = _inputs(robot, r)
        self.recorded = r.positions(robot)
        self.rate = np.gradient(self.recorded, r.dt, axis=0)
        m = len(robot.joints)
        servo = np.array([d is not None and r.has("command", n) for d, n in zip(self.drives, robot.joints, strict=True)])
        torque = np.array([d is None and r.has("torque", n) for d, n in zip(self.drives, robot.joints, strict=True)])
        self.servo, self.torque, self.imposed = servo, torque, ~servo & ~torque
        self.factor = np.array([1.0 if d is None else d.servo.scale / d.gear for d in self.drives])  # target per command
        self.zero = np.array([0.0 if d is None else d.slots[SLOT["zero"]] for d in self.drives])
        self.native = model.dof_frictionloss[self.lead].copy()
        self.state, self.out = np.zeros((m, 4)), np.zeros((m, 5))
        self.carried = np.any(slots != slots_by_joint((), robot)[0])
        self.limits = np.any(np.isfinite(slots[:, SLOT["limit"]]) | (slots[:, SLOT["stall"]] > 0))
        self.delay = slots[:, SLOT["delay"]].copy()
        self.dt = r.dt
        data.qpos[:] = robot.tie @ self.recorded[0] + robot.rest
        self._activate()
        mujoco.mj_forward(model, data)
        self._gains()

    def _activate(self) -> None:
        """Filtered and integrated commands start where the joint is, or at the first command."""
        for d in self.drives:
            if d is not None and self.model.actuator_actadr[d.actuator] >= 0 and self.model.actuator_actnum[d.actuator] > 0:
                at = int(self.model.actuator_actadr[d.actuator])
                start = d.gear * self.recorded[0, d.joint] / d.servo.scale
                self.data.act[at] = start if d.servo.target is Target.INTEGRATED else self.inputs.first[0, d.joint]

    def _gains(self) -> None:
        """Tracking loop (m,): M_jj w^2 and 2 M_jj w, critically damped."""
        M = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, M)
        inertia = np.einsum("im,ij,jm->m", self.robot.tie, M, self.robot.tie)
        w = 2 * math.pi * TRACKING
        self.stiff, self.damp = inertia * w**2, 2 * inertia * w

    def position(self) -> np.ndarray:
        """Position (m,) of the independent joints."""
        return np.asarray(self.data.qpos[self.lead])

    def velocity(self) -> np.ndarray:
        """Velocity (m,) of the independent joints."""
        return np.asarray(self.data.qvel[self.lead])

    def given(self) -> np.ndarray:
        """Torque (m,) of the tracking loop, NaN at servos."""
        return np.where(self.torque, self.loop, np.nan) if hasattr(self, "loop") else np.where(self.torque, 0.0, np.nan)

    def step(self, t: float, k: int) -> None:
        """One step about the time t, between the samples k and k + 1."""
        d, model = self.data, self.model
        q, v = d.qpos[self.lead], d.qvel[self.lead]
        u = self.inputs.at(t - self.delay)
        applied = np.zeros(len(q))
        f = t / self.dt - k
        where, rate = (x[k] + f * (x[k + 1] - x[k]) for x in (self.recorded, self.rate))
        if self.torque.any():
            self.loop = self.stiff * (where - q) + self.damp * (rate - v)
            applied += np.where(self.torque, self.loop, 0.0)
        if self.carried:
            act(self.slots, self.native, self.zero, u * self.factor, q, v, self._load(), t, self.h, self.state, self.out)
            model.dof_frictionloss[self.lead] = self.out[:, 0]
            applied += self.out[:, 1]
            u = np.where(self.servo, self.out[:, 2] / self.factor, u)
            if self.limits:
                self._limit()
        for j, a in enumerate(self.actuators):
            if a >= 0:
                d.ctrl[a] = u[j]
        d.qfrc_applied[self.lead] = applied
        if self.imposed.any():
            for array, value in ((d.qpos, where), (d.qvel, rate)):
                array[self.lead[self.imposed]] = value[self.imposed]
        mujoco.mj_step(model, d)

    def _load(self) -> np.ndarray:
        """Torque (m,) that the links need: gravity and velocity terms, and inertia without the joint's armature."""
        inertia = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, inertia, self.data.qacc)
        inertia -= self.model.dof_armature * self.data.qacc
        return np.asarray((self.data.qfrc_bias + inertia - self.data.qfrc_gravcomp) @ self.robot.tie)

    def _limit(self) -> None:
        """Force ranges of the actuators of joints whose limit is carried."""
        for j, a in enumerate(self.actuators):
            if a >= 0 and math.isfinite(self.out[j, 4]):
                g = abs(float(self.robot.gear[j]))
                self.model.actuator_forcelimited[a] = 1
                self.model.actuator_forcerange[a] = self.out[j, 3] / g, self.out[j, 4] / g


def _actuators(robot: Robot) -> list[int]:
    """Actuator of each independent joint, -1 where there is none."""
    out = [-1] * len(robot.joints)
    for a in range(robot.model.nu):
        name = robot.dofs[int(robot.model.actuator_trnid[a, 0])]
        if name in robot.joints:
            out[robot.joints.index(name)] = a
    return out
