"""The soft limits of a file's driven joint as MuJoCo has them."""

from __future__ import annotations

import copy
import dataclasses
import math

import mujoco
import numpy as np

from mjsim.axis import Axis
from mjsim.chain import Limit
from mjsim.mjcf.load import Model

__all__ = ["limit_of", "on_joint", "with_limit"]

ALIKE = 1e-6  # relative difference of two numbers that are one


def with_limit(axis: Axis, model: Model) -> Axis:
    """An axis of a model with the limits of its driven joint, where the file has them."""
    limit = limit_of(model)
    if limit is None:
        return axis
    first, *others = axis.chain.bodies
    bodies = (dataclasses.replace(first, limit=limit), *others)
    return dataclasses.replace(axis, chain=dataclasses.replace(axis.chain, bodies=bodies))


def limit_of(model: Model) -> Limit | None:
    """The limits of the driven joint over the angle of the chain; None where there are none, or none that `Limit` stands for.

    Read from the constraint that MuJoCo makes. Not read: limits without stiffness, and those of a joint that other joints follow
    by equalities, since their regularisation is of another inertia than the body's.
    """
    m = copy.copy(model.mjmodel)
    j = int(mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_JOINT, model.axis.chain.bodies[0].joint))
    if j < 0 or not m.jnt_limited[j]:
        return None
    along = model.found.base()[int(m.jnt_dofadr[j])]
    inertia = float(m.dof_invweight0[int(m.jnt_dofadr[j])]) * model.axis.chain.bodies[0].inertia
    if abs(inertia - 1.0) > ALIKE or abs(along[0] - 1.0) > ALIKE or np.any(np.abs(along[1:]) > ALIKE):
        return None
    data = mujoco.MjData(m)
    adr, (low, high), margin = int(m.jnt_qposadr[j]), m.jnt_range[j], float(m.jnt_margin[j])
    data.qpos[adr] = low - 1.0  # where MuJoCo makes the constraint whose numbers are read
    mujoco.mj_forward(m, data)
    rows = (data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT)) & (data.efc_id == j)
    if not rows.any():
        return None
    stiffness, damping = (float(x) for x in data.efc_KBIP.reshape(-1, 4)[np.flatnonzero(rows)[0], :2])
    zero = float(m.qpos0[adr])
    if not (stiffness > 0 and math.isfinite(stiffness) and low + margin < high - margin):
        return None
    return Limit(float(low) + margin - zero, float(high) - margin - zero, stiffness, damping, _impedance(m.jnt_solimp[j]))


def on_joint(limit: Limit, model: mujoco.MjModel, joint: str, inertia: float) -> Limit:
    """A limit over the angle of the chain as the limit of a joint [rad | m] of a compiled file.

    inertia: of the chain's first body in that file [kg m^2 | kg]. MuJoCo regularises by m = d / ((1 - d) w) with
    w = dof_invweight0, which is 1 / inertia unless other joints follow this one by equalities. Else d' = c d / (1 - d + c d) with
    c = w inertia gives the same m, and K' = K d / d' the same spring where the impedance d has risen to its end.
    """
    its = model.joint(joint)
    zero, share = float(model.qpos0[its.qposadr[0]]), float(model.dof_invweight0[its.dofadr[0]]) * inertia
    moved = dataclasses.replace(limit, lower=limit.lower + zero, upper=limit.upper + zero)
    if abs(share - 1.0) <= ALIKE:
        return moved
    low, high, *shape = limit.impedance
    first, last = (share * d / (1.0 - d + share * d) for d in (low, high))
    width, middle, power = shape
    return dataclasses.replace(moved, stiffness=limit.stiffness * high / last, impedance=(first, last, width, middle, power))


def _impedance(solimp: np.ndarray) -> tuple[float, float, float, float, float]:
    """solimp (5) within the bounds that MuJoCo sets."""
    low, high, width, middle, power = (float(x) for x in solimp)
    least, most = float(mujoco.mjMINIMP), float(mujoco.mjMAXIMP)
    low, high, middle = (min(max(x, least), most) for x in (low, high, middle))
    return low, high, max(width, 0.0), middle, max(power, 1.0)
