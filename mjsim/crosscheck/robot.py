"""MuJoCo against the equations of a robot, joint by joint: the recursive Newton-Euler rows of `mjsim.robot.rows`.

Compared along an exciting trajectory: the torque of the motion (`mj_inverse`), the inertia at each joint (`mj_fullM`), the
acceleration under a torque (`mj_forward`) and the force of each servo; and free runs of MuJoCo beside the equations integrated
by the same Runge-Kutta rule. Dry friction, limits, contacts and ties are compliant constraints of MuJoCo and no part of these
equations: they are switched off. Errors are relative rms; limits are those of rounding, and for the file's own integrator what
halving its timestep changes.
"""

from __future__ import annotations

import copy
import time as clock
from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from mjsim.crosscheck.engines import judge
from mjsim.crosscheck.report import Cell, Report, Row
from mjsim.errors import InputError
from mjsim.robot.drives import joint_drives
from mjsim.robot.exciting import Excitation, Limits, exciting
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot
from mjsim.robot.rows import inertia_along, link_rows, nominal_torque

__all__ = ["check_robot_model"]

TRUTH = "Newton-Euler"
EXACT = 1e-9  # of what is evaluated once: rounding of some thousand operations beside a condition number of 1e4
SAME = 1e-6  # of a run by the same rule: rounding grown over its steps
SAMPLES, SECONDS = 200, 0.25
BASE_HZ, HARMONICS = 0.1, 5
MARGIN = 4.0  # on what halving the timestep changes: twice the error of a rule of first order, and its own error beside it
SKIPPED = (
    ("dry friction, limits, contacts, ties", "compliant constraints of MuJoCo, no part of the rigid-body equations"),
    ("effects at joints", "simgap crosscheck robot_axis1 compares each of them"),
)


def check_robot_model(robot: Robot) -> Iterator[Row | Report]:
    """Every comparison of a robot; yields each row as it is done and last the report. Raises InputError where a run diverges."""
    wanted = exciting(robot, np.random.default_rng(0), np.linspace(0, 1 / BASE_HZ, SAMPLES), BASE_HZ, HARMONICS, Limits())
    rows: list[Row] = []
    for make in (_torques, _inertias, _accelerations, _servos, _runs):
        for row in make(robot, wanted):
            rows.append(row)
            yield row
    yield Report(tuple(rows), SKIPPED, robot=True)


def _bare(robot: Robot, *, actuators: bool = False) -> mujoco.MjModel:
    """A copy without constraints, and without actuators unless these are compared."""
    model = copy.copy(robot.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    if not actuators:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    return model


def _full(robot: Robot, z: np.ndarray) -> np.ndarray:
    """Positions (N, n) of all joints."""
    return np.asarray(z @ robot.tie.T + robot.rest)


def _each(robot: Robot, model: mujoco.MjModel, e: Excitation, read: Callable[[mujoco.MjData], np.ndarray]) -> np.ndarray:
    """What MuJoCo gives at each sample of the trajectory (N, m)."""
    data, out = mujoco.MjData(model), np.empty_like(e.z)
    q, v, a = _full(robot, e.z), e.dz @ robot.tie.T, e.ddz @ robot.tie.T
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        out[k] = read(data)
    return out


def _joint_rows(robot: Robot, what: str, ours: np.ndarray, theirs: np.ndarray, seconds: float) -> Iterator[Row]:
    for j, name in enumerate(robot.joints):
        cell = judge("literal", theirs[:, j], ours[:, j], EXACT, False, seconds / len(robot.joints))
        yield Row(f"{what}, {name}", TRUTH, 0.0, 0.0, (cell,))


def _torques(robot: Robot, e: Excitation) -> Iterator[Row]:
    model, begun = _bare(robot), clock.perf_counter()

    def read(data: mujoco.MjData) -> np.ndarray:
        mujoco.mj_inverse(model, data)
        return np.asarray(data.qfrc_inverse @ robot.tie)

    theirs = _each(robot, model, e, read)
    yield from _joint_rows(robot, "torque", nominal_torque(robot, e.z, e.dz, e.ddz), theirs, clock.perf_counter() - begun)


def _inertias(robot: Robot, e: Excitation) -> Iterator[Row]:
    model, begun = _bare(robot), clock.perf_counter()

    def read(data: mujoco.MjData) -> np.ndarray:
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        return np.asarray(np.einsum("im,ij,jm->m", robot.tie, full, robot.tie))

    theirs = _each(robot, model, e, read)
    yield from _joint_rows(robot, "inertia", inertia_along(robot, e.z), theirs, clock.perf_counter() - begun)


def _tied(robot: Robot) -> bool:
    """Whether joints are tied: without its constraints MuJoCo then has more freedoms than the robot."""
    return bool(robot.tie.shape[0] != robot.tie.shape[1])


def _accelerations(robot: Robot, e: Excitation) -> Iterator[Row]:
    if _tied(robot):
        return
    model, begun = _bare(robot), clock.perf_counter()
    torque = 1.5 * nominal_torque(robot, e.z, e.dz, np.zeros_like(e.ddz))
    data, theirs = mujoco.MjData(model), np.empty_like(e.z)
    for k in range(len(theirs)):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = _full(robot, e.z)[k], e.dz[k], torque[k]
        mujoco.mj_forward(model, data)
        theirs[k] = data.qacc
    ours = _acceleration(robot, e.z, e.dz, torque)
    yield from _joint_rows(robot, "acceleration", ours, theirs, clock.perf_counter() - begun)


def _acceleration(robot: Robot, z: np.ndarray, dz: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """M(q)^-1 (tau - b(q, q')) (N, m), M by unit accelerations, in one pass of the recursion."""
    n, m = z.shape
    still = np.zeros_like(z)
    zs, vs, accs = np.tile(z, (m + 2, 1)), np.tile(still, (m + 2, 1)), np.tile(still, (m + 2, 1))
    vs[:n] = dz
    for j in range(m):
        accs[(2 + j) * n : (3 + j) * n, j] = 1.0
    links = np.einsum("nmlk,lk->nm", link_rows(robot, zs, vs, accs), robot.nominal).reshape(m + 2, n, m)
    bias = links[0] + (robot.damping * dz + robot.stiffness * (_full(robot, z) - robot.spring)) @ robot.tie
    M = np.moveaxis(links[2:] - links[1], 0, 2) + np.diag(robot.armature @ robot.tie**2)
    return np.asarray(np.linalg.solve(M, (torque - bias)[:, :, None])[:, :, 0])


def _servos(robot: Robot, e: Excitation) -> Iterator[Row]:
    """Force of each position servo at the joint, commands a little beside the position: kp (command - zero - q) - kv q'."""
    drives, model = joint_drives(robot), _bare(robot, actuators=True)
    chosen = [d for d in drives if d is not None and not d.velocity and robot.model.actuator_dyntype[d.actuator] == 0]
    begun, beside = clock.perf_counter(), 0.05 * np.sin(np.arange(len(e.z)))
    data = mujoco.MjData(model)
    theirs = np.zeros_like(e.z)
    control = {d.joint: (d.gear * (e.z[:, d.joint] + beside) + d.servo.zero + d.length) / d.servo.scale for d in chosen}
    for k in range(len(e.z)):
        data.qpos[:], data.qvel[:] = _full(robot, e.z)[k], e.dz[k] @ robot.tie.T
        for d in chosen:
            data.ctrl[model.actuator_ctrladr[d.actuator]] = control[d.joint][k]
        mujoco.mj_forward(model, data)
        theirs[k] = data.qfrc_actuator @ robot.tie
    for d in chosen:
        j, p = d.joint, d.slots
        u = d.servo.scale * np.clip(control[j], d.servo.low, d.servo.high) / d.gear
        force = p[SLOT["kp"]] * (u - p[SLOT["zero"]] - e.z[:, j]) - p[SLOT["kv"]] * e.dz[:, j]
        ours = np.clip(force, -p[SLOT["limit"]], p[SLOT["limit"]])
        cell = judge("literal", theirs[:, j], ours, EXACT, False, clock.perf_counter() - begun)
        yield Row(f"servo, {robot.joints[j]}", "servo law", 0.0, 0.0, (cell,))


def _runs(robot: Robot, e: Excitation) -> Iterator[Row]:
    """Free runs under the weight's torque at the start and half of it more: a motion that is not small."""
    if _tied(robot):
        return
    model, h = _bare(robot), float(robot.model.opt.timestep)
    steps = max(2, round(SECONDS / h))
    start = e.z[:1], e.dz[:1]
    torque = 1.2 * nominal_torque(robot, e.z[:1], np.zeros((1, e.z.shape[1])), np.zeros((1, e.z.shape[1])))
    truth = _integrated(robot, *start, torque, h, steps)
    rule = copy.copy(model)
    rule.opt.integrator = int(mujoco.mjtIntegrator.mjINT_RK4)
    begun = clock.perf_counter()
    same = _stepped(robot, rule, *start, torque, h, steps)
    cells = [_judged(robot, "exact", same, truth, SAME, clock.perf_counter() - begun, "MuJoCo by Runge-Kutta")]
    begun = clock.perf_counter()
    plain, finer = (_stepped(robot, model, *start, torque, h / k, k * steps)[::k] for k in (1, 2))
    seconds = clock.perf_counter() - begun
    limit = SAME + MARGIN * float(np.sqrt(np.mean((plain - finer) ** 2) / (np.mean(truth**2) + 1e-300)))
    cells.append(_judged(robot, "literal", plain, truth, limit, seconds, "the file's own integrator and timestep"))
    yield Row("free run, all joints", TRUTH, 0.0, 0.0, tuple(cells))


def _judged(
    robot: Robot, engine: str, run: np.ndarray, truth: np.ndarray, limit: float, seconds: float, note: str
) -> Cell:  # fmt: skip
    if not np.isfinite(run).all():
        raise InputError(
            robot.source, f"a free run of {SECONDS:g} s diverges", "a model that MuJoCo can step", "make its timestep smaller"
        )
    return judge(engine, run, truth, limit, False, seconds, note)


def _integrated(robot: Robot, z: np.ndarray, v: np.ndarray, torque: np.ndarray, h: float, steps: int) -> np.ndarray:
    """Velocities (steps + 1, m) of the equations by the classical Runge-Kutta rule."""
    out = [v[0]]
    for _ in range(steps):
        k = [(v, _acceleration(robot, z, v, torque))]
        for part in (0.5, 0.5, 1.0):
            dz, dv = k[-1]
            k.append((v + part * h * dv, _acceleration(robot, z + part * h * dz, v + part * h * dv, torque)))
        weights = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
        z = z + h * sum(w * dz for w, (dz, _) in zip(weights, k, strict=True))
        v = v + h * sum(w * dv for w, (_, dv) in zip(weights, k, strict=True))
        out.append(v[0])
    return np.array(out)


def _stepped(
    robot: Robot, model: mujoco.MjModel, z: np.ndarray, v: np.ndarray, torque: np.ndarray, h: float, steps: int
) -> np.ndarray:  # fmt: skip
    """Velocities (steps + 1, m) of MuJoCo."""
    model = copy.copy(model)
    model.opt.timestep = h
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = _full(robot, z)[0], v[0], torque[0]
    out = [data.qvel.copy()]
    for _ in range(steps):
        mujoco.mj_step(model, data)
        out.append(data.qvel.copy())
    return np.array(out)
