"""Inverse dynamics along a motion, linear in the inertial parameters of the links: one row a joint.

tau = sum over links Y_l(q, q', q'') phi_l + armature q'' + damping q' + stiffness (q - springref)

Recursive Newton-Euler over all samples at once, in the frame of each link. Velocities and accelerations go from the base to the
tips, with gravity as an acceleration of the base; the wrench of a link is linear in phi_l and is projected on every joint
before it.
Source: C. G. Atkeson, C. H. An, J. M. Hollerbach, Int. J. Robotics Research 5 (1986) 101. `check_rows` compares with mj_inverse.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.robot.inertia import SIZE
from mjsim.robot.model import HINGE, Robot

__all__ = ["Frames", "check_rows", "frames", "inertia_along", "link_rows", "mujoco_torque", "nominal_torque"]


@dataclass(frozen=True, eq=False)
class Frames:
    """Motion of all bodies along N samples: arrays by body id.

    R (N, 3, 3): body to world; p (N, 3): origin [m]; w, dw (N, 3): angular velocity and acceleration; a (N, 3): acceleration of
    the origin minus gravity, all in the world frame; axis, anchor (N, 3): by dof.
    """

    R: list[np.ndarray]
    p: list[np.ndarray]
    w: list[np.ndarray]
    dw: list[np.ndarray]
    a: list[np.ndarray]
    axis: list[np.ndarray]
    anchor: list[np.ndarray]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product along the last axis; faster than `numpy.cross` on many short vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) about a unit axis (3,) by angles (N,) (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * K + (1 - c) * (K @ K))


def _matrix(quat: np.ndarray) -> np.ndarray:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quat)
    return out.reshape(3, 3)


def frames(robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Frames:
    """Motion of all bodies from positions, velocities and accelerations (N, n) of all dofs."""
    m, n = robot.model, len(q)
    zero = np.zeros((n, 3))
    gravity = np.zeros(3) if m.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY) else m.opt.gravity
    f = Frames([np.broadcast_to(np.eye(3), (n, 3, 3))], [zero], [zero], [zero], [zero - gravity], [], [])
    for b in range(1, m.nbody):
        parent = int(m.body_parentid[b])
        R0, w, dw = f.R[parent], f.w[parent], f.dw[parent]
        arm = R0 @ m.body_pos[b]
        R, p = R0 @ _matrix(m.body_quat[b]), f.p[parent] + arm
        acc = f.a[parent] + _cross(dw, arm) + _cross(w, _cross(w, arm))
        first = int(m.body_jntadr[b])
        for j in range(first, first + int(m.body_jntnum[b])):
            axis = R @ m.jnt_axis[j]
            anchor = p + R @ m.jnt_pos[j]
            f.axis.append(axis)
            f.anchor.append(anchor)
            rate, change = axis * v[:, j, None], axis * a[:, j, None] + _cross(w, axis) * v[:, j, None]
            if int(m.jnt_type[j]) == HINGE:
                to = anchor - p
                at = acc + _cross(dw, to) + _cross(w, _cross(w, to))  # of the anchor, which the joint leaves where it is
                R = R @ _turn(m.jnt_axis[j], q[:, j] - m.qpos0[j])
                w, dw = w + rate, dw + change
                back = -(R @ m.jnt_pos[j])
                p = anchor + back
                acc = at + _cross(dw, back) + _cross(w, _cross(w, back))
            else:
                shift = axis * (q[:, j, None] - m.qpos0[j])
                acc = acc + _cross(dw, shift) + _cross(w, _cross(w, shift)) + change + _cross(w, rate)
                p = p + shift
        for kept, value in zip((f.R, f.p, f.w, f.dw, f.a), (R, p, w, dw, acc), strict=True):
            kept.append(value)
    return f


def _inertia_columns(w: np.ndarray) -> np.ndarray:
    """L(w) (N, 3, 6) with I w = L(w) [Ixx Iyy Izz Ixy Ixz Iyz]."""
    x, y, z = w[:, 0], w[:, 1], w[:, 2]
    L = np.zeros((len(w), 3, 6))
    L[:, 0, 0], L[:, 0, 3], L[:, 0, 4] = x, y, z
    L[:, 1, 1], L[:, 1, 3], L[:, 1, 5] = y, x, z
    L[:, 2, 2], L[:, 2, 4], L[:, 2, 5] = z, x, y
    return L


def _skew(w: np.ndarray) -> np.ndarray:
    S = np.zeros((len(w), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    return S - np.swapaxes(S, 1, 2)


def _wrench(w: np.ndarray, dw: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment about the origin, linear in phi: (N, 3, 10) each, in the frame of the body."""
    n = len(w)
    W = _skew(w)
    force, moment = np.zeros((n, 3, SIZE)), np.zeros((n, 3, SIZE))
    force[:, :, 0] = a
    force[:, :, 1:4] = _skew(dw) + W @ W
    moment[:, :, 1:4] = -_skew(a)
    moment[:, :, 4:] = _inertia_columns(dw) + W @ _inertia_columns(w)
    return force, moment


def link_rows(robot: Robot, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> np.ndarray:
    """Regressor (N, m, L, 10) of the independent joints' torques in the links' inertial parameters.

    z, dz, ddz (N, m): position, velocity and acceleration of the independent joints [rad | m]. Gravity is in it; armature,
    damping
    and springs are not.
    """
    m = robot.model
    f = frames(robot, z @ robot.tie.T + robot.rest, dz @ robot.tie.T, ddz @ robot.tie.T)
    rows = np.zeros((len(z), len(robot.dofs), len(robot.links), SIZE))
    held = bool(np.any(m.body_gravcomp > 0))  # MuJoCo looks for negative ones only where there is a positive one
    for at, b in enumerate(robot.links):
        back = np.swapaxes(f.R[b], 1, 2)
        a = f.a[b] + m.body_gravcomp[b] * m.opt.gravity if held else f.a[b]
        w, dw, a = (np.einsum("nij,nj->ni", back, x) for x in (f.w[b], f.dw[b], a))
        force, moment = _wrench(w, dw, a)
        for j in _ancestors(m, b):
            axis = np.einsum("nij,nj->ni", back, f.axis[j])
            if int(m.jnt_type[j]) == HINGE:
                lever = np.einsum("nij,nj->ni", back, f.p[b] - f.anchor[j])
                rows[:, j, at] = np.einsum("ni,nik->nk", axis, moment) + np.einsum("ni,nik->nk", _cross(axis, lever), force)
            else:
                rows[:, j, at] = np.einsum("ni,nik->nk", axis, force)
    return rows if robot.tie.shape[0] == robot.tie.shape[1] else np.einsum("jm,njlk->nmlk", robot.tie, rows)


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Dofs between the base and a body."""
    out: list[int] = []
    while body > 0:
        first = int(model.body_jntadr[body])
        out += range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return out


def inertia_along(robot: Robot, z: np.ndarray) -> np.ndarray:
    """M_jj (N, m) along positions (N, m): what joint j takes for a unit acceleration of its own, armature included."""
    still = np.zeros_like(z)
    weight = link_rows(robot, z, still, still)
    out = np.empty_like(z)
    for j in range(z.shape[1]):
        unit = still.copy()
        unit[:, j] = 1.0
        out[:, j] = np.einsum("nlk,lk->n", (link_rows(robot, z, still, unit) - weight)[:, j], robot.nominal)
    inertias: np.ndarray = out + robot.armature @ robot.tie**2
    return inertias


def nominal_torque(robot: Robot, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> np.ndarray:
    """Torque (N, m) that the robot of the file needs along a motion (N, m), its dry friction left out."""
    rows = np.einsum("nmlk,lk->nm", link_rows(robot, z, dz, ddz), robot.nominal)
    q, v, a = z @ robot.tie.T + robot.rest, dz @ robot.tie.T, ddz @ robot.tie.T
    torque: np.ndarray = rows + (robot.armature * a + robot.damping * v + robot.stiffness * (q - robot.spring)) @ robot.tie
    return torque


def check_rows(robot: Robot, samples: int = 5, tolerance: float = 1e-6) -> float:
    """Largest relative difference between `nominal_torque` and mj_inverse on random motions, limits and dry friction left out.

    Raises InputError where it is above ``tolerance``: the file then holds forces that the rows do not have (a fluid, tendons
    with springs, damping that is a polynomial).
    """
    rng = np.random.default_rng(0)
    m = robot.tie.shape[1]
    z, dz, ddz = (scale * rng.standard_normal((samples, m)) for scale in (0.5, 1.0, 2.0))
    mine = nominal_torque(robot, z, dz, ddz)
    model, data = robot.model, mujoco.MjData(robot.model)
    flags = model.opt.disableflags
    worst = 0.0
    try:
        model.opt.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        for k in range(samples):
            data.qpos[:], data.qvel[:], data.qacc[:] = robot.tie @ z[k] + robot.rest, robot.tie @ dz[k], robot.tie @ ddz[k]
            mujoco.mj_inverse(model, data)
            theirs = data.qfrc_inverse @ robot.tie
            worst = max(worst, float(np.max(np.abs(mine[k] - theirs)) / (np.max(np.abs(theirs)) + 1e-300)))
    finally:
        model.opt.disableflags = flags
    if not worst < tolerance:
        raise InputError(
            robot.source, f"its inverse dynamics hold more than links, armatures, dampings and springs (differs by {worst:.1e})",
            "no fluid, no tendon springs, no nonlinear damping", "remove them in a copy of the model",
        )  # fmt: skip
    return worst


def mujoco_torque(robot: Robot, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> np.ndarray:
    """Torque (N, m) that plain MuJoCo finds for a motion (N, m) by mj_inverse, the file's dry friction and springs included.

    Contacts and limits are left out: the recording is taken for free of them.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    q, v, a = z @ robot.tie.T + robot.rest, dz @ robot.tie.T, ddz @ robot.tie.T
    out = np.empty_like(z)
    flags = model.opt.disableflags
    off = mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_LIMIT, mujoco.mjtDisableBit.mjDSBL_EQUALITY
    try:
        model.opt.disableflags = flags | sum(int(bit) for bit in off)
        for k in range(len(z)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            out[k] = data.qfrc_inverse @ robot.tie
    finally:
        model.opt.disableflags = flags
    return out
