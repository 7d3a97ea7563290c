"""Stepping any MJCF in plain MuJoCo on inputs of its joints, for films of models that are no single-axis chain."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.mjcf.compile import caught_warnings, compile_file
from mjsim.mjcf.drive_laws import law_of, range_of
from mjsim.ode import DivergedError

__all__ = ["demonstration", "held_still", "stepped"]

SECONDS, RATE = 6.0, 200.0  # of a demonstration: its length [s], its samples per second
SWING = {True: 0.3, False: 0.1}  # about what it moves a hinge [rad] and a slide [m] by
HELD = 1e8  # times its inertia: a degree of freedom that forces move by nothing that is seen


def stepped(
    path: Path, model: mujoco.MjModel, inputs: Mapping[int, np.ndarray], count: int, dt: float, qpos: np.ndarray, qvel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (N, nq) and velocities (N, nv) at N = ``count`` samples of dt [s], each input (N,) held over its sample.

    ``inputs``: of a joint's actuator, by joint id: the torque of a motor, the command of a servo. A torque of a joint without an
    actuator acts on the joint. Other controls stay at the first keyframe, else 0. The file's timestep is shortened where dt is
    no multiple of it. Raises DivergedError when MuJoCo warns or the motion is not finite.
    """
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[:], data.qvel[:] = qpos, qvel
    own = float(model.opt.timestep)
    steps = max(1, math.ceil(dt / own - 1e-6))
    on = {j: _actuator(model, j) for j in inputs}
    poses, speeds = np.empty((count, model.nq)), np.empty((count, model.nv))
    model.opt.timestep = dt / steps
    try:
        with caught_warnings() as said:
            for k in range(count):
                poses[k], speeds[k] = data.qpos, data.qvel
                for j, u in inputs.items():
                    if on[j] is None:
                        data.qfrc_applied[model.jnt_dofadr[j]] = u[k]
                    else:
                        data.ctrl[model.actuator_ctrladr[on[j]]] = u[k]
                for _ in range(steps):
                    mujoco.mj_step(model, data)
                if said or not np.isfinite(data.qpos).all():
                    line = said[0].split(". Time")[0] if said else "the motion is not finite"
                    raise DivergedError(f"{path.name}: MuJoCo stopped at {k * dt:.4f} s ({line}); use a smaller timestep")
    finally:
        model.opt.timestep = own
    return poses, speeds


def _actuator(model: mujoco.MjModel, joint: int) -> int | None:
    """The first actuator with an input that acts on a joint directly."""
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for a in map(int, np.flatnonzero(model.actuator_ctrlnum)):
        if int(model.actuator_trntype[a]) in kinds and int(model.actuator_trnid[a, 0]) == joint:
            return a
    return None


def held_still(path: Path, joint: int, qpos: np.ndarray) -> mujoco.MjModel:
    """The model with all joints held but one and those tied to it: an armature so large that nothing moves them.

    Raises InputError when the joint is driven by a servo, whose input is a command and no torque.
    """
    model = compile_file(path)
    a = _actuator(model, joint)
    if a is not None and model.actuator_biastype[a] != mujoco.mjtBias.mjBIAS_NONE:
        raise InputError(
            path, f"actuator {model.actuator(a).name!r} is a servo, whose input is a command", "a recording with the "
            f"column {model.joint(joint).name}.command_rad", "add it, or give the simulated motion by --simulation",
        )  # fmt: skip
    free = {joint}
    for e in range(model.neq):
        pair = {int(model.eq_obj1id[e]), int(model.eq_obj2id[e])}
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and model.eq_active0[e] and pair & free:
            free |= pair
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    largest = float(np.max(np.diag(inertia)))
    held = ~np.isin(model.dof_jntid, list(free))
    model.dof_armature[held] += HELD * largest
    return model


def demonstration(
    path: Path, model: mujoco.MjModel, start: np.ndarray
) -> tuple[str, np.ndarray, np.ndarray, list[tuple[str, str, np.ndarray]]]:
    """What moves a model that no recording moves: each actuator on its own slow sine, from the keyframe.

    Returns what it is, times (N,), poses (N, nq), and name, unit and values of up to three curves. A servo is commanded by the
    sine; a motor is given the torque that moves its joint's inertia so far. A model without actuators is let fall.
    """
    count, dt = int(SECONDS * RATE), 1.0 / RATE
    time = dt * np.arange(count)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[:] = start
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    inputs: dict[int, np.ndarray] = {}
    for j in range(model.njnt):
        a = _actuator(model, j)
        if a is None:
            continue
        law = law_of(model, a)
        w = 2 * math.pi * (0.35 + 0.12 * len(inputs))
        swing = SWING[model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
        gear, gain = float(model.actuator_gear[a, 0]) or 1.0, law.gain or 1.0
        if not (law.of_length or law.of_speed):
            dof = int(model.jnt_dofadr[j])
            swing *= float(inertia[dof, dof]) * w**2 / (gear * gain)
        inputs[j] = np.clip(float(data.ctrl[model.actuator_ctrladr[a]]) + swing * np.sin(w * time), *range_of(model, a))
    said = "simulation, each actuator on a slow sine" if inputs else "simulation, no input"
    qpos, _ = stepped(path, model, inputs, count, dt, start, np.zeros(model.nv))
    simple = [j for j in range(model.njnt) if int(model.jnt_type[j]) >= int(mujoco.mjtJoint.mjJNT_SLIDE)]
    shown = sorted(sorted(simple, key=lambda j: -float(np.ptp(qpos[:, model.jnt_qposadr[j]])))[:3])
    units = {True: "rad", False: "m"}
    curves = [
        (model.joint(j).name, units[model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE], qpos[:, model.jnt_qposadr[j]])
        for j in shown
    ]
    return said, time, qpos, curves
