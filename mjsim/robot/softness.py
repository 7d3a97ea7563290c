"""How soft MuJoCo makes the dry friction of a robot's joints, read from its own constraints.

The friction of a joint is f = s (q'' + k q') where that is below its level (MuJoCo documentation, Computation, Constraint model):
1/s is the regulariser R of the constraint, k the rate of its reference acceleration. A loaded joint creeps under it.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from mjsim.mjcf.softness import holds
from mjsim.robot.model import Robot

__all__ = ["friction_softness"]


def friction_softness(robot: Robot) -> np.ndarray:
    """(s [kg m^2 | kg], k [1/s]) of the dry friction (m, 2) that each joint has or would have; zeros where it holds at rest."""
    m = copy.copy(robot.model)
    m.dof_frictionloss[m.dof_frictionloss == 0] = 1.0  # so that MuJoCo makes the constraint whose numbers are read
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    leading = {robot.leading(j): j for j in range(len(robot.joints))}
    out = np.zeros((len(robot.joints), 2))
    rows = zip(data.efc_type, data.efc_id, data.efc_KBIP.reshape(-1, 4), data.efc_R, strict=True)
    for kind, index, (_, rate, impedance, _), regulariser in rows:
        if int(kind) != int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF) or int(index) not in leading:
            continue
        if not holds(float(impedance), float(rate), float(m.opt.timestep)):
            out[leading[int(index)]] = 1.0 / float(regulariser), float(rate)
    return out
