"""All joints of a robot together in MuJoCo, with the file's own options, along a recording.

Servos are driven by the recorded commands. A joint that is driven by a torque gets the logged one and a tracking loop beside
it, since
torques alone drift; what the loop has to give is the error of the model as a torque. Joints that are not in the log are held
where they
are. The timestep is the file's, or the next smaller one that divides the sample time.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjsim.hold import between, delayed
from mjsim.mjcf.drive_laws import begin, law_of
from mjsim.robot.carried import act, slots_by_joint
from mjsim.robot.drives import JointDrive, joint_drives
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.servo import Target
from mjsim.trapezoid import finely, parts_of

__all__ = ["ClosedLoop", "closed_loop", "motor_gain"]

FASTEST = 1e6  # [rad/s | m/s]: a run beyond it has diverged
FIRST, SETTLED = 50, 5.0  # samples at least, and times kp / ki: how long the start of a servo's integral shows
NUDGE = 1e-3  # [rad | m]: what an integral at the start is moved by, as an angle under kp
SMOOTH = 4.0  # times the bandwidth of the tracking loop: the low-pass of the positions that it follows
TRACKING = 5.0  # [Hz]: bandwidth of the tracking loop of joints that are driven by a torque


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """One run: position and velocity (N, m), torque (N, m) of the tracking loop (NaN at servos), and the effects that were
    left out."""

    z: np.ndarray
    dz: np.ndarray
    tracking: np.ndarray
    lacking: tuple[str, ...]

    @property
    def diverged(self) -> bool:
        """Whether the run left finite numbers."""
        return not bool(np.isfinite(self.z).all())


def _inputs(robot: Robot, r: RobotRecording, t: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """Commands of servos and torques of other actuators (S, m), behind the profile and the delay of carried slots (m, K).

    They are means over the steps of which times (S,) [s] are the middle.
    """
    h = float(t[1] - t[0]) if len(t) > 1 else r.dt
    drives = joint_drives(robot)
    out = np.zeros((len(t), len(robot.joints)))
    for j, name in enumerate(robot.joints):
        channel = "torque" if drives[j] is None else "command"
        if not r.has(channel, name):
            continue
        values = getattr(r, channel)[:, r.joints.index(name)] / (motor_gain(robot, j) if drives[j] is None else 1.0)
        (first, slope), dt, drive = between(values, r.dt, r.hold), r.dt, drives[j]
        if drive is not None and slots[j, SLOT["acceleration"]] > 0.0:
            dt = r.dt / parts_of(r.dt)
            first, slope = _profile(first, slope, r.dt, drive, slots[j])
        ends = t[0] - 0.5 * h - slots[j, SLOT["delay"]] + h * np.arange(len(t) + 1)
        out[:, j] = np.diff(_integral(first, slope, dt, ends)) / h
    return out


def _profile(
    first: np.ndarray, slope: np.ndarray, dt: float, drive: JointDrive, slots: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Command at the start of each step of its profile, and its slope there, from those of each sample of dt [s].

    slots (K,): carried ones; a velocity limit of the file is that of the profile as well. A command that the servo integrates is
    the rate of the target.
    """
    if drive.servo.target is Target.INTEGRATED:
        ends = np.cumsum((first + 0.5 * dt * slope) * dt)
        first, slope = between(np.concatenate([[0.0], ends[:-1]]), dt, "linear")
    limits = [float(x) for x in (slots[SLOT["slew"]], drive.slots[SLOT["slew"]]) if x > 0.0]
    unit = abs(drive.gear / drive.servo.scale)  # command per target
    most, rate = unit * min(limits, default=math.inf), unit * float(slots[SLOT["acceleration"]])
    fine = finely(first, slope, dt, most, rate)
    speed = np.diff(fine) / (dt / parts_of(dt))
    return (speed, np.zeros_like(speed)) if drive.servo.target is Target.INTEGRATED else (fine[:-1], speed)


def _integral(first: np.ndarray, slope: np.ndarray, dt: float, t: np.ndarray) -> np.ndarray:
    """Integral from 0 to t (S,) of an input by its values at the samples and slopes over them (N,); held beyond its ends."""
    each = first * dt + 0.5 * slope * dt**2
    sums = np.concatenate([[0.0], np.cumsum(each)])
    k = np.clip(np.floor(t / dt), 0, len(first) - 1).astype(int)
    into = t - k * dt
    return np.asarray(sums[k] + first[k] * into + 0.5 * np.where((into < 0) | (into > dt), 0.0, slope[k]) * into**2)


def closed_loop(
    robot: Robot,
    recording: RobotRecording,
    effects: Sequence[Mapping[str, Any]] = (),
    samples: int | None = None,
    *,
    finer: int = 1,
    sampled: bool = False,
) -> ClosedLoop:
    """Run all joints along a recording, or its first ``samples``, with the effects that a corrected file carries.

    ``finer``: steps for each step of the file's timestep, to measure the integration error. ``sampled``: the tracking loop acts
    at the samples and is held between them, as a digital controller's, and its torque is that of the sample that follows.
    """
    model = copy.copy(robot.model)
    r, n = recording, samples or len(recording)
    each = finer * max(1, math.ceil(r.dt / float(model.opt.timestep) - 1e-6))
    model.opt.timestep = r.dt / each
    slots, lacking = slots_by_joint(effects, robot)

    def run(wound: np.ndarray, count: int = n) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        this = _Run(robot, copy.copy(model), mujoco.MjData(model), r, slots, count, each, sampled, wound)
        return this.plain() if this.native_only else this.stepped()

    z, dz, tracking = run(_wound(robot, r, n, run))
    for j, late in enumerate(slots[:, SLOT["late"]]):  # the log's clock, no matter of the motion
        if late > 0.0:
            z[:, j], dz[:, j] = delayed(z[:, j], late / r.dt), delayed(dz[:, j], late / r.dt)
    gone = np.flatnonzero(~np.isfinite(z).all(axis=1) | (np.max(np.abs(dz), axis=1) > FASTEST))
    if len(gone):
        z[gone[0] :] = np.nan
    return ClosedLoop(z, dz, tracking, lacking)


def _wound(robot: Robot, r: RobotRecording, n: int, run: Callable[..., tuple[np.ndarray, ...]]) -> np.ndarray:
    """Torque (m,) of servos' integrals at the start, beyond what holds the robot there, that suits the recording best.

    By least squares over the first samples, which know of the start, in which the positions are linear in it; zero at joints
    without integral action.
    """
    wound = np.zeros(len(robot.joints))
    drives = [d for d in joint_drives(robot) if d is not None and d.slots[SLOT["integral"]] > 0.0]
    known = [r.has("command", robot.joints[d.joint]) and robot.joints[d.joint] in r.joints for d in drives]
    drives = [d for d, there in zip(drives, known, strict=True) if there]
    if not drives:
        return wound
    slowest = max(float(d.slots[SLOT["kp"]] / d.slots[SLOT["integral"]]) for d in drives)
    count = min(n, max(FIRST, math.ceil(SETTLED * slowest / r.dt)))
    at = [d.joint for d in drives]
    recorded, before = r.positions(robot)[:count, at], run(wound, count)[0][:, at]
    columns = []
    for d in drives:
        moved = wound.copy()
        moved[d.joint] = float(d.slots[SLOT["kp"]]) * NUDGE
        columns.append(((run(moved, count)[0][:, at] - before) / moved[d.joint]).ravel())
    A, e = np.column_stack(columns), (recorded - before).ravel()
    keep = np.isfinite(A).all(axis=1) & np.isfinite(e)
    wound[at] = np.linalg.lstsq(A[keep], e[keep], rcond=1e-9)[0] if keep.any() else 0.0
    return wound


class _Run:
    """MuJoCo's state along a recording, and what acts on it at each step."""

    def __init__(
        self,
        robot: Robot,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        r: RobotRecording,
        slots: np.ndarray,
        n: int,
        each: int,
        sampled: bool,
        wound: np.ndarray,
    ) -> None:
        self.robot, self.model, self.data, self.slots, self.n, self.each = robot, model, data, slots, n, each
        self.h, self.sampled, self.hold = float(model.opt.timestep), sampled, r.hold
        self.drives = joint_drives(robot)
        self.lead = np.array([robot.leading(j) for j in range(len(robot.joints))])
        self.recorded = r.positions(robot)
        servo = np.array([d is not None and r.has("command", x) for d, x in zip(self.drives, robot.joints, strict=True)])
        torque = np.array([d is None and r.has("torque", x) for d, x in zip(self.drives, robot.joints, strict=True)])
        self.torque, self.imposed = torque, ~servo & ~torque
        self.t = (np.arange((n - 1) * each) + 0.5) * self.h
        self.u = _inputs(robot, r, self.t, slots)
        self.factor = np.array([1.0 if d is None else d.servo.scale / d.gear for d in self.drives])  # target per command
        self.zero = np.array([0.0 if d is None else d.slots[SLOT["zero"]] for d in self.drives])
        self.native = model.dof_frictionloss[self.lead].copy()
        self.carried = bool(np.any(slots != slots_by_joint((), robot)[0]))
        self.limits = bool(np.any(np.isfinite(slots[:, SLOT["limit"]]) | (slots[:, SLOT["stall"]] > 0)))
        self.columns = np.array([j for j, a in enumerate(robot.actuators) if a >= 0], int)
        self.actuators = np.array([a for a in robot.actuators if a >= 0], int)
        self.addresses = np.asarray(model.actuator_ctrladr)[self.actuators]
        data.qpos[:] = robot.tie @ self.recorded[0] + robot.rest
        rate = np.gradient(_smooth(self.recorded, r.dt)[:3], r.dt, axis=0)[0]
        data.qvel[:] = robot.tie @ np.where(servo, 0.0, rate)  # joints that follow the recording begin as it does
        self.wound = wound
        self._activate()
        mujoco.mj_forward(model, data)

    @property
    def native_only(self) -> bool:
        """Whether nothing acts but what the file itself has."""
        return not (self.carried or self.torque.any() or self.imposed.any())

    def plain(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and torque of the tracking loop (N, m), by MuJoCo's own loop over all steps."""
        from mujoco import rollout

        control = np.zeros((1, len(self.t), self.model.nu))
        control[0][:, self.addresses] = self.u[:, self.columns]
        state = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(self.model, self.data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        states, _ = rollout.rollout(self.model, self.data, state, control)
        kept = np.vstack([state, states[0][self.each - 1 :: self.each]])
        nq, nv = self.model.nq, self.model.nv
        z, dz = kept[:, 1 : 1 + nq][:, self.lead], kept[:, 1 + nq : 1 + nq + nv][:, self.lead]
        return z, dz, np.full_like(z, np.nan)

    def stepped(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, step by step, with what is carried, the tracking loop and joints that are moved as recorded."""
        d, model, lead = self.data, self.model, self.lead
        m, per = len(lead), self.each
        z, dz, tracking = (np.full((self.n, m), np.nan) for _ in range(3))
        at = self.t / (per * self.h)
        k = np.minimum(at.astype(int), self.n - 2)
        dt = per * self.h
        followed = _smooth(self.recorded, dt)
        where = followed[k] + (at - k)[:, None] * (followed[k + 1] - followed[k])
        slope = np.gradient(followed, dt, axis=0)
        rate = slope[k] + (at - k)[:, None] * (slope[k + 1] - slope[k])
        stiff, damp = self._gains()
        state, out, loop = np.zeros((m, 4)), np.zeros((m, 5)), np.zeros(m)
        z[0], dz[0], tracking[0] = d.qpos[lead], d.qvel[lead], loop
        if self.sampled:
            tracking[0] = self._computed(followed[0], slope[0])
        u, speed, applied = self.u, self._speed(), np.zeros(m)
        for i in range(len(self.t)):
            q, v = d.qpos[lead], d.qvel[lead]
            if self.sampled and i % per == 0:
                loop = self._computed(followed[i // per], slope[i // per])
            elif self.torque.any() and not self.sampled:
                loop = np.where(self.torque, stiff * (where[i] - q) + damp * (rate[i] - v), 0.0)
            applied = loop
            inputs = u[i]
            if self.carried:
                drive = (d.qfrc_actuator @ self.robot.tie) + loop
                goal = inputs * self.factor
                act(self.slots, self.native, self.zero, goal, speed[i], q, v, self._load(), drive, self.t[i], self.h, state, out)
                model.dof_frictionloss[lead] = out[:, 0]
                applied = loop + out[:, 1]
                inputs = np.where(self.torque, inputs, out[:, 2] / self.factor)
                if self.limits:
                    self._limit(out)
            d.ctrl[self.addresses] = inputs[self.columns]
            d.qfrc_applied[lead] = applied
            if self.imposed.any():
                d.qpos[lead[self.imposed]], d.qvel[lead[self.imposed]] = where[i][self.imposed], rate[i][self.imposed]
            mujoco.mj_step(model, d)
            if (i + 1) % per == 0:
                row = (i + 1) // per
                z[row], dz[row], tracking[row] = d.qpos[lead], d.qvel[lead], loop
                if self.sampled:
                    tracking[row] = self._computed(followed[row], slope[row])
                if not np.isfinite(z[row]).all():
                    break
        return z, dz, np.where(self.torque, tracking, np.nan)

    def _speed(self) -> np.ndarray:
        """Speed (T, m) of the servos' targets at each step: of a held command its last step over a sample."""
        if not self.slots[:, SLOT["lead"]].any():
            return np.zeros_like(self.u)
        moving = np.gradient(self.u, self.h, axis=0)
        if self.hold == "held":
            before = np.concatenate([np.repeat(self.u[:1], self.each, axis=0), self.u[: -self.each]])
            profiled = self.slots[:, SLOT["acceleration"]] > 0.0
            moving = np.where(profiled, moving, (self.u - before) / (self.each * self.h))
        return np.asarray(moving * self.factor)

    def _activate(self) -> None:
        """Filtered and integrated commands start where the joint is, or at the first command; a servo's integral holds it."""
        mujoco.mj_forward(self.model, self.data)
        held = (self.data.qfrc_bias - self.data.qfrc_passive) @ self.robot.tie
        for d in self.drives:
            if d is not None:
                start = (d.gear * self.recorded[0, d.joint] + d.length) / d.servo.scale
                u = float(self.u[0, d.joint])
                asked = d.servo.kp * (d.servo.scale * u - d.servo.zero - d.gear * self.recorded[0, d.joint] - d.length)
                force = (held[d.joint] + self.wound[d.joint]) / d.gear - asked
                begin(self.model, self.data, d.actuator, u, u, start, force)

    def _gains(self) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and damping (m,) of the tracking loop: M_jj w^2 and 2 M_jj w, critically damped."""
        M = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, M)
        inertia = np.einsum("im,ij,jm->m", self.robot.tie, M, self.robot.tie)
        w = 2 * math.pi * TRACKING
        return inertia * w**2, 2 * inertia * w

    def _computed(self, to: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Torque (m,) of the sampled loop, M (w^2 e + 2 w e') with M of the present pose: all joints alike, and stable where
        2 w dt is below 2, which is why w is at most half the sampling rate."""
        M = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, M)
        w = min(2 * math.pi * TRACKING, 0.5 / (self.each * self.h))
        e, v = to - self.data.qpos[self.lead], rate - self.data.qvel[self.lead]
        wanted = np.where(self.torque, w**2 * e + 2 * w * v, 0.0)
        return np.where(self.torque, (self.robot.tie.T @ M @ self.robot.tie) @ wanted, 0.0)

    def _load(self) -> np.ndarray:
        """Torque (m,) that the links need: gravity and velocity terms, and inertia without the joint's armature."""
        inertia = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, inertia, self.data.qacc)
        inertia -= self.robot.armature * self.data.qacc
        return np.asarray((self.data.qfrc_bias + inertia - self.data.qfrc_gravcomp) @ self.robot.tie)

    def _limit(self, out: np.ndarray) -> None:
        """Force ranges of the actuators of joints whose limit is carried."""
        for j, a in zip(self.columns, self.actuators, strict=True):
            if math.isfinite(out[j, 4]):
                g = abs(float(self.robot.gear[j]))
                self.model.actuator_forcelimited[a] = 1
                self.model.actuator_forcerange[a] = out[j, 3] / g, out[j, 4] / g


def motor_gain(robot: Robot, joint: int) -> float:
    """Force of a joint's actuator for a unit of its control, where that is a torque; 1 for a joint without."""
    a = robot.actuators[joint]
    gain = law_of(robot.model, a).gain if a >= 0 else 1.0
    return gain if gain != 0.0 else 1.0


def _smooth(z: np.ndarray, dt: float) -> np.ndarray:
    """Positions (N, m) behind a zero-phase low-pass of `SMOOTH` times the tracking loop's bandwidth."""
    from scipy.signal import butter, sosfiltfilt

    cutoff = 2 * SMOOTH * TRACKING * dt
    if cutoff >= 0.9 or len(z) < 30:
        return z
    return np.asarray(sosfiltfilt(butter(2, cutoff, output="sos"), z, axis=0))
