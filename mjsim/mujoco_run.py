"""Plain MuJoCo on a recorded input: what the MJCF file says, stepped by MuJoCo itself, and nothing besides.

Effects that MJCF cannot express are not in it; `run_signals` adds those that act on the signals alone (dead zone, droop, sensor
lag, rounding, offset), which need no stepping of their own.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from mjsim.effects import ports as P  # noqa: N812
from mjsim.mjcf import Model, load_model
from mjsim.mjcf.compile import caught_warnings
from mjsim.mjcf.drive_laws import begin
from mjsim.ode import DivergedError, Trajectory, _sense, apply_input
from mjsim.system import assemble

__all__ = ["lacking", "run_literal", "run_signals"]

_CHUNK = 200_000  # steps whose states are kept in memory at once
_SIGNAL = (P.InputMap, P.OutputMap, P.OutputLag)


def run_literal(
    model: str | Path | Model,
    torque: np.ndarray,
    dt: float,
    *,
    initial: np.ndarray | None = None,
    before: float = 0.0,
    timestep: float | None = None,
    known: np.ndarray | None = None,
) -> Trajectory:
    """Run a single-axis MJCF in plain MuJoCo on a commanded torque (N,) held over each sample of dt [s].

    The file's timestep is taken, shortened where dt is no multiple of it; ``timestep`` [s] overrides it. ``initial`` (2, n):
    angles and velocities of the chain's bodies; ``before``: torque ahead of the first sample, for a delay or lag; ``known`` (N,):
    a torque on body 0 beside the drive's, with straight lines between its samples and their mean over each step. Measured
    signals come from the bound sensors when the file has them. Raises DivergedError naming the time, the element and what to
    change; a warning of MuJoCo is such an error.
    """
    source = model if isinstance(model, Model) else load_model(model)
    torque = np.asarray(torque, float)
    found, m = source.found, source.mjmodel
    own = float(m.opt.timestep)
    steps = max(1, math.ceil(dt / (timestep or own) - 1e-6))
    m.opt.timestep = dt / steps
    try:
        qpos, qvel, sensed = _roll(source, torque, steps, initial, before, known)
    finally:
        m.opt.timestep = own
    q, v = qpos @ found.rows.T, qvel @ found.rows.T
    velocity, angle = (
        sensed.get(name, true) for name, true in ((found.chain.velocity_sensor, v[:, 0]), (found.chain.angle_sensor, q[:, 0]))
    )
    return Trajectory(
        dt * np.arange(len(torque)), torque.copy(), velocity.copy(), angle.copy(), q, v, _coupling_torque(source, qpos, qvel)
    )


def run_signals(
    model: str | Path | Model,
    torque: np.ndarray,
    dt: float,
    *,
    initial: np.ndarray | None = None,
    before: float = 0.0,
    timestep: float | None = None,
    known: np.ndarray | None = None,
) -> Trajectory:
    """`run_literal` with the effects of the axis that act on its signals alone laid around it."""
    source = model if isinstance(model, Model) else load_model(model)
    system = assemble(source.axis)
    run = run_literal(
        source, apply_input(system, np.asarray(torque, float)), dt, initial=initial, before=before, timestep=timestep, known=known
    )
    # a delay of the measurement stands at the sensors of the file already
    system = dataclasses.replace(system, output_delay=0.0)
    velocity, angle = _sense(system, run.velocity, run.angle, dt)
    return Trajectory(run.time, np.array(torque, float), velocity.copy(), angle.copy(), run.q, run.v, run.coupling_torque)


def lacking(model: Model) -> tuple[str, ...]:
    """What `run_signals` lacks of the axis: the effects that MJCF cannot express and that act inside the chain."""
    if model.carried is None:
        return ()
    signal = {e.key for e in model.axis.effects if all(isinstance(p, _SIGNAL) for p in e.ports(model.axis.chain))}
    return tuple(line for key, line in model.carried.lacks if key not in signal)


def _roll(
    source: Model, torque: np.ndarray, steps: int, initial: np.ndarray | None, before: float, known: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Angles and velocities (N, nv) of the joints and the bound sensors (N,) at the sample times."""
    m, found = source.mjmodel, source.found
    data = mujoco.MjData(m)
    start = np.zeros((2, len(found.chain.bodies))) if initial is None else np.asarray(initial, float)
    data.qpos[:] = m.qpos0 + found.base() @ start[0]
    data.qvel[:] = found.base() @ start[1]
    drive = found.layout.drive.id
    if drive >= 0:
        begin(m, data, drive, before, float(torque[0]), integral=source.integral_force())
    for s in range(m.nsensor):
        own = {found.chain.velocity_sensor: start[1, 0], found.chain.angle_sensor: start[0, 0]}.get(m.sensor(s).name)
        if own is not None and m.sensor_history[s, 0] > 0:
            mujoco.mj_initSensorHistory(m, data, s, None, np.full((int(m.sensor_history[s, 0]), 1), own), 0.0)
    count = len(torque)
    qpos, qvel = np.empty((count, m.nq)), np.empty((count, m.nv))
    wanted = {found.chain.velocity_sensor, found.chain.angle_sensor}
    columns = {m.sensor(s).name: int(m.sensor_adr[s]) for s in range(m.nsensor) if m.sensor(s).name in wanted}
    sensed = {name: np.empty(count) for name in columns}
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(m, spec))
    control = np.zeros((1, steps * count, sum(m.actuator_ctrlnum)))
    if drive >= 0:
        control[0, :, m.actuator_ctrladr[drive]] = np.repeat(torque, steps)
    given = int(mujoco.mjtState.mjSTATE_CTRL)
    if known is not None:
        given |= int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
        middle = np.interp((np.arange(steps * count) + 0.5) / steps, np.arange(count), np.asarray(known, float))
        control = np.concatenate([control, (middle[:, None] * found.rows[0])[None]], axis=2)
    per_chunk = max(1, _CHUNK // steps)
    with caught_warnings() as said:
        for first in range(0, count, per_chunk):
            last = min(first + per_chunk, count)
            mujoco.mj_getState(m, data, state, spec)
            states, sensors = rollout.rollout(
                m,
                data,
                state[None],
                control[:, first * steps : last * steps] if control.size else None,
                control_spec=given,
                nstep=(last - first) * steps,
                initial_warmstart=data.qacc_warmstart[None].copy(),
            )
            at = np.vstack([state[None], states[0, steps - 1 : -1 : steps]])
            qpos[first:last], qvel[first:last] = at[:, 1 : 1 + m.nq], at[:, 1 + m.nq : 1 + m.nq + m.nv]
            for name, column in columns.items():
                sensed[name][first:last] = sensors[0, ::steps, column]
            _check(source, data, states[0], said)
            mujoco.mj_setState(m, data, states[0, -1], spec)
    return qpos, qvel, sensed


def _check(source: Model, data: mujoco.MjData, states: np.ndarray, said: list[str]) -> None:
    """A warning, a value that is not finite or a run that stopped early is an error with a time, an element and a remedy."""
    m = source.mjmodel
    bad = np.flatnonzero(~np.all(np.isfinite(states[:, 1:]), axis=1) | (np.abs(np.diff(states[:, 0], prepend=np.nan)) <= 0))
    warned = [w for w in range(len(data.warning)) if data.warning[w].number]
    if not warned and not len(bad) and not said:
        return
    line = said[0] if said else "the motion is not finite"
    digits = line.replace(".", " ").split()
    dof = next((int(b) for a, b in itertools.pairwise(digits) if a == "DOF" and b.isdigit()), None)
    element = f"joint {m.joint(int(m.dof_jntid[dof])).name!r}" if dof is not None and dof < m.nv else "the model"
    at = float(line.rsplit("Time = ", 1)[1].rstrip(". ")) if "Time = " in line else float(states[bad[0] if len(bad) else -1, 0])
    raise DivergedError(
        f"{source.path.name}: MuJoCo stopped at {at:.4f} s at {element} ({line.split('. Time')[0].rstrip('.')}); "
        f"use a smaller timestep than {m.opt.timestep:g} s, or correct the stiffness or damping there"
    )


def _coupling_torque(source: Model, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Torque of each coupling, on its own side, from its springs and dampers as MuJoCo has them (N, n-1)."""
    found, m = source.found, source.mjmodel
    out = np.zeros((len(qpos), len(found.on_coupling)))
    for j, parts in enumerate(found.on_coupling):
        for p in parts:
            e = p.element
            x, v = (qpos - m.qpos0) @ e.row, qvel @ e.row
            x = x - np.clip(x, -0.5 * e.gap, 0.5 * e.gap)
            k, d = e.stiffness, e.damping
            force = k[0] * x + k[1] * x**2 + k[2] * x**3 + d[0] * v + d[1] * v * np.abs(v) + d[2] * v**3
            out[:, j] += p.scale * force
    return out
