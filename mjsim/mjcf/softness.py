"""How soft MuJoCo makes the dry friction of a file's joints and tendons, read from its own constraints."""

from __future__ import annotations

import copy
import dataclasses

import mujoco
import numpy as np

from mjsim.axis import Axis
from mjsim.chain import Softness
from mjsim.mjcf.load import Model

__all__ = ["has_soft_friction", "holds", "with_softness"]

HELD = 1e-3  # share of an acceleration that is left below the friction level, down to which a joint counts as held
SETTLED = 0.5  # of a velocity that goes in a timestep, from which on friction counts as holding at once


def with_softness(axis: Axis, model: Model) -> Axis:
    """An axis of a model whose bodies have the softness that their dry friction has in MuJoCo, or would have there.

    A body takes that of its frictional elements where these are all alike, and that of its joint where it has none.
    """
    soft = _softness(model.mjmodel)
    bodies = []
    for body, parts in zip(axis.chain.bodies, model.found.on_body, strict=True):
        elements = {(p.element.kind, p.element.id) for p in parts if p.element.friction}
        found = {soft.get(e) for e in elements or [("joint", _joint(model.mjmodel, body.joint))]}
        bodies.append(dataclasses.replace(body, softness=found.pop()) if len(found) == 1 else body)
    return dataclasses.replace(axis, chain=dataclasses.replace(axis.chain, bodies=tuple(bodies)))


def has_soft_friction(model: Model) -> bool:
    """Whether a file has dry friction that MuJoCo does not hold at rest."""
    soft = _softness(model.mjmodel)
    return any(p.element.friction and (p.element.kind, p.element.id) in soft for parts in model.found.on_body for p in parts)


def holds(impedance: float, rate: float, timestep: float) -> bool:
    """Whether dry friction of this impedance and rate [1/s] holds a joint at rest at a timestep [s]."""
    return 1.0 - impedance <= HELD and impedance * rate * timestep >= SETTLED


def _joint(m: mujoco.MjModel, name: str) -> int:
    return int(mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_JOINT, name))


def _softness(model: mujoco.MjModel) -> dict[tuple[str, int], Softness]:
    """Softness of each joint and tendon whose dry friction MuJoCo does not hold at rest, by kind and index."""
    m = copy.copy(model)
    m.dof_frictionloss[m.dof_frictionloss == 0] = 1.0  # so that MuJoCo makes the constraint whose numbers are read
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    joint, tendon = (int(k) for k in (mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF, mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON))
    out = {}
    numbers = data.efc_KBIP.reshape(-1, 4)
    for row, (kind, index) in enumerate(zip(data.efc_type, data.efc_id, strict=True)):
        if int(kind) not in (joint, tendon):
            continue
        rate, impedance = float(numbers[row, 1]), _impedance(m, data, row)
        if not holds(impedance, rate, float(m.opt.timestep)):
            at = ("joint", int(m.dof_jntid[index])) if int(kind) == joint else ("tendon", int(index))
            out[at] = Softness(impedance, rate)
    return out


def _impedance(m: mujoco.MjModel, data: mujoco.MjData, row: int) -> float:
    """A / (A + R) of a constraint: d of solimp where MuJoCo regularises by the inverse inertia A along the constraint.

    It takes ``dof_invweight0`` for A, which leaves out the armature of a slide whose centre of mass is at the joint.
    """
    along, at_rest = np.zeros((1, m.nv)), np.zeros((1, m.nv))
    if mujoco.mj_isSparse(m):
        start, count = int(data.efc_J_rowadr[row]), int(data.efc_J_rownnz[row])
        along[0, data.efc_J_colind[start : start + count]] = data.efc_J[start : start + count]
    else:
        along[0] = data.efc_J.reshape(-1, m.nv)[row]
    mujoco.mj_solveM(m, data, at_rest, along)
    inverse = float(along[0] @ at_rest[0])
    return inverse / (inverse + float(data.efc_R[row]))
