"""Motions of a user's own model as poses: a simulation in plain MuJoCo, a recording, a demonstration.

A recording sets the angle of the joint that it measures (and of the joints tied to it); other joints stay at the model's first
keyframe, else at qpos0. A robot's recording, with columns ``JOINT.angle_rad``, sets every joint that it names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mjsim.control import as_driven
from mjsim.errors import InputError
from mjsim.mjcf import Model, carried_binding, load_model
from mjsim.mjcf.compile import compile_file
from mjsim.ode import DivergedError, Trajectory
from mjsim.readers import read_table
from mjsim.recording import Recording, load
from mjsim.render.drive import demonstration, held_still, stepped
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.model import load_robot
from mjsim.robot.recording import load_robot_recording
from mjsim.robot.scenario import RobotLog
from mjsim.robot.write import carried_effects

__all__ = ["Curve", "Rig", "Take", "recorded", "simulated", "take_of_robot", "take_of_run"]


@dataclass(frozen=True)
class Curve:
    """A signal to draw over the time of a take: its name, unit and values (N,), None where it was not measured."""

    name: str
    unit: str
    values: np.ndarray | None


@dataclass(frozen=True)
class Take:
    """A motion: times (N,) [s] on a uniform grid, poses (N, nq), and curves to draw under the picture."""

    name: str
    time: np.ndarray
    qpos: np.ndarray
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Rig:
    """A model to film. ``axis``: the single-axis chain that it is, None when it is none. ``joint``: the driven joint's id.

    ``start``: pose (nq,) of all that a recording does not set.
    """

    path: Path
    model: mujoco.MjModel
    axis: Model | None
    joint: int | None
    start: np.ndarray

    @classmethod
    def of(cls, path: Path, joint: str | None = None) -> Rig:
        """The rig of a file; ``joint`` names the one that a recording measures. Raises InputError."""
        model = compile_file(path)
        start = np.array(model.key_qpos[0] if model.nkey else model.qpos0)
        names = [model.joint(i).name for i in range(model.njnt)]
        if joint is not None and joint not in names:
            from mjsim.errors import nearest

            raise InputError(f"--joint {joint!r}", f"no such joint in {path.name}", f"one of: {', '.join(names)}",
                             nearest(joint, names))  # fmt: skip
        try:
            axis = load_model(path)
        except InputError:  # no single-axis chain: filmed all the same
            driven = _driven(model)
            number = names.index(joint) if joint is not None else (driven[0] if len(driven) == 1 else None)
            return cls(path, model, None, number, start)
        own = int(np.argmax(np.abs(axis.found.layout.drive.row)))
        number = names.index(joint) if joint is not None else int(model.dof_jntid[own])
        return cls(path, model, axis, number, np.array(model.qpos0))

    def unit(self, joint: int) -> tuple[str, str, str]:
        """Units of angle, velocity and torque of a joint."""
        hinge = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        return ("rad", "rad/s", "N m") if hinge else ("m", "m/s", "N")

    def needed_joint(self) -> int:
        """The joint that a recording of one joint measures. Raises InputError when it is not known which."""
        if self.joint is not None:
            return self.joint
        names = ", ".join(self.model.joint(j).name for j in _driven(self.model) or range(self.model.njnt))
        raise InputError(self.path, "several joints, and the recording measures one", f"one of: {names}", "name it by --joint")

    def with_joints(self, angles: Mapping[int, np.ndarray]) -> np.ndarray:
        """Poses (N, nq) with the angles (N,) of some joints, and of joints tied to them by joint equalities."""
        m = self.model
        count = len(next(iter(angles.values())))
        out = np.tile(self.start, (count, 1))
        for j, angle in angles.items():
            out[:, m.jnt_qposadr[j]] = angle
        for e in range(m.neq):
            if m.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT or not m.eq_active0[e]:
                continue
            follower, leader = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
            a, b = m.jnt_qposadr[follower], m.jnt_qposadr[leader] if leader >= 0 else -1
            if leader in angles and follower not in angles:
                powers = (out[:, b] - m.qpos0[b])[:, None] ** np.arange(5)
                out[:, a] = m.qpos0[a] + powers @ m.eq_data[e, :5]
            elif follower in angles and leader >= 0 and leader not in angles and m.eq_data[e, 1]:
                out[:, b] = m.qpos0[b] + (out[:, a] - m.qpos0[a] - m.eq_data[e, 0]) / m.eq_data[e, 1]
        return out


def _driven(model: mujoco.MjModel) -> list[int]:
    """Hinges and slides that an actuator acts on directly, in the order of the actuators."""
    simple = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    on_joint = np.isin(model.actuator_trntype, (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    found = [int(j) for j in model.actuator_trnid[on_joint, 0] if int(model.jnt_type[int(j)]) in simple]
    return list(dict.fromkeys(found))


def take_of_run(rig: Rig, name: str, run: Trajectory) -> Take:
    """A run of the chain as poses of its model."""
    assert rig.axis is not None
    found = rig.axis.found
    bodies = len(found.chain.bodies)
    qpos = rig.model.qpos0 + run.q[:, :bodies] @ found.base().T
    return Take(name, run.time, qpos, _curves(rig, run.torque, run.angle, run.velocity))


def _curves(rig: Rig, torque: np.ndarray, angle: np.ndarray | None, velocity: np.ndarray | None) -> tuple[Curve, ...]:
    angle_unit, velocity_unit, torque_unit = rig.unit(rig.joint or 0)
    hinge = angle_unit == "rad"
    return (
        Curve("torque" if hinge else "force", torque_unit, None if np.isnan(torque).all() else torque),
        Curve("angle" if hinge else "position", angle_unit, angle),
        Curve("velocity", velocity_unit, velocity),
    )


def _angle(record: Recording) -> np.ndarray:
    """The recorded angle (N,), or the velocity's integral by the trapezoidal rule from 0."""
    if record.angle is not None:
        return record.angle
    v = record.column("velocity")
    return np.concatenate([[0.0], np.cumsum(0.5 * record.dt * (v[1:] + v[:-1]))])


def recorded(rig: Rig, path: Path, name: str = "recording") -> Take:
    """The motion of a recording. Raises InputError."""
    robot = _robot_log(rig, path)
    if robot is not None:
        return robot.take(rig, name)
    record = _load(rig, path)
    angle = _angle(record)
    if rig.axis is not None:
        found = rig.axis.found
        ratios = np.array([found.chain.total_ratio(i) for i in range(len(found.chain.bodies))])
        qpos = rig.model.qpos0 + np.outer(angle, found.base() @ ratios)
    else:
        qpos = rig.with_joints({rig.needed_joint(): angle})
    return Take(name, record.time - record.time[0], qpos, _curves(rig, record.torque, record.angle, record.velocity))


def _load(rig: Rig, path: Path) -> Recording:
    binding = carried_binding(rig.axis, path) if rig.axis is not None else None
    record = load(path, model=rig.path, binding=binding, driven=rig.model.nactuator > 0)
    return record if rig.axis is None else as_driven(rig.axis.axis.chain, record)


def simulated(
    rig: Rig, recording: Path | None, name: str = "simulation", ready: Callable[[Recording], Recording] = lambda r: r
) -> Take:
    """The model in plain MuJoCo on the input of a recording, from its first sample; a demonstration without one.

    Effects that a corrected model carries and plain MuJoCo lacks are simulated by the analytic equations instead. A recording
    of one joint of a robot moves that joint; the others are held. ``ready``: what is made of a recording of one joint before its
    input is taken. Raises InputError, also when the simulation diverges.
    """
    try:
        if recording is None:
            said, time, qpos, curves = demonstration(rig.path, rig.model, rig.start)
            return Take(said, time, qpos, tuple(Curve(*c) for c in curves))
        robot = _robot_log(rig, recording)
        if robot is not None:
            return robot.simulated(rig, name)
        record = ready(_load(rig, recording))
        return _chain(rig, record, name) if rig.axis is not None else _one_joint(rig, record, name)
    except DivergedError as error:
        raise InputError(rig.path, str(error)) from None


def _chain(rig: Rig, record: Recording, name: str) -> Take:
    from mjsim.mujoco_run import lacking, run_signals
    from mjsim.ode import simulate

    assert rig.axis is not None
    chain = rig.axis.found.chain
    ratios = np.array([chain.total_ratio(i) for i in range(len(chain.bodies))])
    initial = np.stack([ratios * _angle(record)[0], ratios * _first_speed(record)])
    if lacking(rig.axis):
        run = simulate(rig.axis.axis, record.input, record.dt, initial=initial, angle=record.angle)
    else:
        run = run_signals(rig.axis, record.input, record.dt, initial=initial, before=float(record.input[0]))
    return take_of_run(rig, name, run)


def _first_speed(record: Recording) -> float:
    """The speed at the first sample, by a straight line through the first 5 ms of velocity."""
    v = record.velocity if record.velocity is not None else np.gradient(_angle(record), record.dt)
    few = max(2, min(len(v), round(0.005 / record.dt)))
    return float(np.polynomial.Polynomial.fit(np.arange(few), v[:few], 1)(0.0))


def _one_joint(rig: Rig, record: Recording, name: str) -> Take:
    joint = rig.needed_joint()
    qpos = rig.with_joints({joint: _angle(record)[:1]})[0]
    model = held_still(rig.path, joint, qpos)
    speed = np.zeros(model.nv)
    speed[model.jnt_dofadr[joint]] = _first_speed(record)
    poses, speeds = stepped(rig.path, model, {joint: record.torque}, len(record.torque), record.dt, qpos, speed)
    angle, velocity = poses[:, model.jnt_qposadr[joint]], speeds[:, model.jnt_dofadr[joint]]
    return Take(name, record.time - record.time[0], poses, _curves(rig, record.torque, angle, velocity))


@dataclass(frozen=True)
class _RobotLog:
    """A recording of several joints: time (N,), angles and inputs (commands or torques) by joint id."""

    path: Path
    time: np.ndarray
    angles: Mapping[int, np.ndarray]
    inputs: Mapping[int, np.ndarray]

    def shown(self) -> Sequence[int]:
        """The three joints that move most."""
        return sorted(sorted(self.angles, key=lambda j: -float(np.ptp(self.angles[j])))[:3])

    def curves(self, rig: Rig, qpos: np.ndarray) -> tuple[Curve, ...]:
        """Angles of the joints that move most."""
        m = rig.model
        return tuple(Curve(m.joint(j).name, rig.unit(j)[0], qpos[:, m.jnt_qposadr[j]]) for j in self.shown())

    def take(self, rig: Rig, name: str) -> Take:
        """The recorded motion."""
        qpos = rig.with_joints(self.angles)
        return Take(name, self.time, qpos, self.curves(rig, qpos))

    def simulated(self, rig: Rig, name: str) -> Take:
        """The motion of the model on the recorded commands and torques."""
        if not self.inputs:
            raise InputError(self.path, "no input of a joint", "JOINT.command_rad or JOINT.torque_Nm", "add a column")
        together = _together(rig, self.path)
        if together is not None:
            return Take(name, self.time, together, self.curves(rig, together))
        dt = float((self.time[-1] - self.time[0]) / (len(self.time) - 1))
        start = rig.with_joints({j: a[:1] for j, a in self.angles.items()})[0]
        speed = np.zeros(rig.model.nv)
        for j, a in self.angles.items():
            speed[rig.model.jnt_dofadr[j]] = (a[1] - a[0]) / dt
        qpos, _ = stepped(rig.path, rig.model, self.inputs, len(self.time), dt, start, speed)
        return Take(name, self.time, qpos, self.curves(rig, qpos))


def _together(rig: Rig, path: Path) -> np.ndarray | None:
    """Poses (N, nq) of all joints of a robot on a recording, as ``simgap replay`` runs them; None for what is no robot.

    Joints that a torque drives are held to the recording by a tracking loop.
    """
    try:
        robot = load_robot(rig.path)
        run = closed_loop(robot, load_robot_recording(path, robot, model=rig.path), carried_effects(rig.path))
    except InputError:
        return None
    return None if run.diverged else run.z @ robot.tie.T + robot.rest


def take_of_robot(rig: Rig, log: RobotLog) -> Take:
    """The motion of a scenario of a robot."""
    shown = sorted(range(len(log.robot.joints)), key=lambda j: -float(np.ptp(log.wanted.z[:, j])))[:3]
    ids = sorted(log.robot.leading(j) for j in shown)
    curves = (Curve(rig.model.joint(j).name, rig.unit(j)[0], log.qpos[:, j]) for j in ids)
    return Take(f"simulation of {log.scenario.name}", log.columns["time_s"], log.qpos, tuple(curves))


def _robot_log(rig: Rig, path: Path) -> _RobotLog | None:
    """The file as a recording of several joints, by its column names; None when no column names a joint's angle."""
    if not path.is_file():
        raise InputError(path, "no such file", "a recording (.csv, .mat, .npz, .parquet, .mcap)", "check the path")
    m = rig.model
    names = {m.joint(j).name: j for j in range(m.njnt)}
    table = read_table(path)
    angles, inputs = {}, {}
    for column, values in table.items():
        joint, _, what = column.rpartition(".")
        if joint not in names:
            continue
        if what in ("angle_rad", "angle_m"):
            angles[names[joint]] = values
        elif what in ("command_rad", "command_m", "torque_Nm", "torque_N"):
            inputs[names[joint]] = values
    if not angles:
        return None
    time = table.get("time_s")
    columns = [*angles.values(), *inputs.values()]
    if time is None or len(time) < 2 or any(c.shape != time.shape or not np.isfinite(c).all() for c in [*columns, time]):
        raise InputError(path, "joint columns without a common time", "time_s and finite columns of its length", "add it")
    dt = (time[-1] - time[0]) / (len(time) - 1)
    if not dt > 0 or float(np.max(np.abs(np.diff(time) - dt))) > 0.5 * dt or math.isinf(dt):
        raise InputError(path, "time_s is not uniform", "uniform sampling", "resample the recording first")
    return _RobotLog(path, time - time[0], angles, inputs)
