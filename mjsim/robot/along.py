"""What each joint of a robot carries along a recorded motion: inertia, torque of the links, and its derivatives, by MuJoCo.

    tau_j = M_jj(q) q_j'' + b_j(q, q', q''_others)

M_jj, b_j and the derivatives of b_j by q_j and q_j' come from `mj_inverse` and its differences (`mjd_inverseFD`) at every
sample. Armature,
damping and dry friction of the joints are left out: they are laws of the joint itself. Gravity, gravity compensation and the
springs of the file are in b.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.robot.model import Robot

__all__ = ["Along", "along"]

EPS = 1e-6  # step of the differences [rad | m], MuJoCo's own choice for mjd_transitionFD


@dataclass(frozen=True, eq=False)
class Along:
    """Series (N, m) at the samples of a motion: inertia M_jj, torque b_j, db_j/dq_j, db_j/dq'_j, the whole torque tau_j, and of
    it that of gravity alone, less what is compensated."""

    inertia: np.ndarray
    bias: np.ndarray
    by_position: np.ndarray
    by_velocity: np.ndarray
    torque: np.ndarray
    weight: np.ndarray


def along(robot: Robot, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray, links: np.ndarray | None = None) -> Along:
    """Series along a motion (N, m) [rad | m, per second, per second squared] of the independent joints.

    links (L, 10): inertial parameters of the links, without what is fixed to them, in the place of the file's.
    """
    model = _bare(robot, links)
    data = mujoco.MjData(model)
    nv, T = model.nv, robot.tie
    q, v, a = z @ T.T + robot.rest, dz @ T.T, ddz @ T.T
    out = [np.empty_like(z) for _ in range(6)]
    Dq, Dv, Da = (np.empty((nv, nv)) for _ in range(3))
    for k in range(len(z)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], 0.0, 0.0
        mujoco.mj_inverse(model, data)  # at rest, the bias is gravity
        weight = (data.qfrc_bias - data.qfrc_gravcomp) @ T
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        torque = data.qfrc_inverse @ T
        mujoco.mjd_inverseFD(model, data, EPS, 0, Dq, Dv, Da, None, None, None, None)
        # rows of the differences are the variable, columns the torque: the diagonal of T' D T
        M, by_q, by_v = (np.einsum("im,ij,jm->m", T, D, T) for D in (Da, Dq, Dv))
        for array, value in zip(out, (M, torque - M * ddz[k], by_q, by_v, torque, weight), strict=True):
            array[k] = value
    return Along(*out)


def _bare(robot: Robot, links: np.ndarray | None) -> mujoco.MjModel:
    """A copy of the model without constraints, armature and damping, with other links where they are given."""
    model = copy.copy(robot.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT) | int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    model.dof_armature[:] = 0.0
    model.dof_damping[:] = 0.0
    model.actuator_armature[:] = 0.0
    model.actuator_damping[:] = 0.0
    model.actuator_dampingpoly[:] = 0.0
    if hasattr(model, "dof_dampingpoly"):
        model.dof_dampingpoly[:] = 0.0
    if links is not None:
        from mjsim.robot.inertia import to_body

        for at, body in enumerate(robot.links):
            mass, centre, quat, principal = to_body(links[at])
            model.body_mass[body], model.body_ipos[body] = mass, centre
            model.body_iquat[body], model.body_inertia[body] = quat, principal
            model.body_sameframe[body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)  # else MuJoCo takes the body's own axes
    return model
