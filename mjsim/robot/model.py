"""The user's MJCF as a robot: which joints move, what drives them, which bodies are links; what is outside is refused.

A robot is a fixed-base tree of hinges and slides. Joints that an equality makes proportional to another one (a gear, a mimic
joint) follow it: q = T z + q0, z the independent joints. Bodies without a joint of their own belong to the link that they
are fixed to.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mjsim.errors import InputError, nearest
from mjsim.mjcf.compile import compile_file
from mjsim.quantity import Motion
from mjsim.robot.inertia import SIZE, from_body, moved
from mjsim.robot.transmission import TREE, name_of, ties, transmission

__all__ = ["Robot", "load_robot", "robot_from"]

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, eq=False)
class Robot:
    """A fixed-base tree with n degrees of freedom, m of them independent, and L links.

    dofs: names of all n joints in MuJoCo's order; joints: names of the m independent ones; tie (n, m), rest (n,): q = tie z
    + rest;
    gear (m,): joint torque over recorded torque; driven (m,): whether an actuator drives it; links: body ids (L,);
    nominal (L, 10): inertial parameters of a link with all that is fixed to it; fixed (L, 10): of what is fixed to it alone.
    armature, damping, frictionloss, stiffness (n,): as in the file, armature and damping with those of the actuator of the
    joint; spring (n,): springref; ranges (n, 2): joint limits, infinite where there are none; motions: hinge or slide of each
    independent joint; actuators (m,): of each of them, -1 where there is none; length (m,): of the actuator where all
    independent joints are at 0.
    """

    source: str
    model: mujoco.MjModel
    dofs: tuple[str, ...]
    joints: tuple[str, ...]
    tie: np.ndarray
    rest: np.ndarray
    gear: np.ndarray
    driven: np.ndarray
    links: tuple[int, ...]
    nominal: np.ndarray
    fixed: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    stiffness: np.ndarray
    spring: np.ndarray
    ranges: np.ndarray
    motions: tuple[Motion, ...]
    actuators: tuple[int, ...]
    length: np.ndarray

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links."""
        return tuple(name_of(self.model, mujoco.mjtObj.mjOBJ_BODY, b) for b in self.links)

    def leading(self, joint: int) -> int:
        """Index among all dofs of an independent joint."""
        return self.dofs.index(self.joints[joint])

    def link_of(self, body: str) -> tuple[int, np.ndarray, np.ndarray]:
        """Link that a body belongs to, and the body's position and orientation in its frame. Raises InputError."""
        names = [name_of(self.model, mujoco.mjtObj.mjOBJ_BODY, b) for b in range(self.model.nbody)]
        if body not in names:
            raise InputError(
                self.source, f"no body {body!r}", f"one of {', '.join(names[1:])}", nearest(body, names[1:], "correct the name")
            )
        at = names.index(body)
        root = int(self.model.body_weldid[at])
        if root not in self.links:
            raise InputError(self.source, f"body {body!r} does not move", "a body of the arm", "correct the name")
        return self.links.index(root), *_pose(self.model, at, root)


def _pose(model: mujoco.MjModel, body: int, root: int) -> tuple[np.ndarray, np.ndarray]:
    """Position and quaternion of a body in the frame of the link that it is fixed to."""
    pos, quat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    while body != root:
        turned, product = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(turned, pos, model.body_quat[body])
        mujoco.mju_mulQuat(product, model.body_quat[body], quat)
        pos, quat, body = turned + model.body_pos[body], product, int(model.body_parentid[body])
    return pos, quat


def load_robot(path: str | Path) -> Robot:
    """The robot of an MJCF file. Raises InputError, in one line, for what is outside."""
    return robot_from(compile_file(path), str(path))


def robot_from(model: mujoco.MjModel, source: str = "model") -> Robot:
    """The robot of a compiled model. Raises InputError for ball and free joints, closed chains and spatial tendons."""
    dofs = _dofs(model, source)
    tie, rest, independent = ties(model, source, dofs)
    drive = transmission(model, source, dofs, tie, rest, independent)
    links = tuple(b for b in range(1, model.nbody) if model.body_weldid[b] == b and model.body_weldid[b] != 0)
    fixed = np.zeros((len(links), SIZE))
    nominal = np.zeros((len(links), SIZE))
    for b in range(1, model.nbody):
        root = int(model.body_weldid[b])
        if root == 0:
            continue
        own = from_body(model.body_mass[b], model.body_ipos[b], model.body_iquat[b], model.body_inertia[b])
        nominal[links.index(root)] += moved(own, *_pose(model, b, root))
        if b != root:
            fixed[links.index(root)] += moved(own, *_pose(model, b, root))
    limited = model.jnt_limited.astype(bool)
    ranges = np.where(limited[:, None], model.jnt_range, [[-np.inf, np.inf]])
    armature, damping = model.dof_armature.copy(), model.dof_damping.copy()
    for k, a in enumerate(drive.actuators):
        if a >= 0:
            armature[independent[k]] += drive.gear[k] ** 2 * model.actuator_armature[a]
            damping[independent[k]] += drive.gear[k] ** 2 * model.actuator_damping[a]
    motions = tuple(Motion.HINGE if model.jnt_type[j] == HINGE else Motion.SLIDE for j in independent)
    return Robot(
        source, model, dofs, tuple(dofs[j] for j in independent), tie, rest, drive.gear, np.array(drive.actuators) >= 0, links,
        nominal, fixed,
        armature, damping, model.dof_frictionloss.copy(), model.jnt_stiffness.copy(),
        model.qpos_spring.copy(), ranges, motions, drive.actuators, drive.length,
    )  # fmt: skip


def _dofs(model: mujoco.MjModel, source: str) -> tuple[str, ...]:
    names = []
    for j in range(model.njnt):
        name = name_of(model, mujoco.mjtObj.mjOBJ_JOINT, j)
        if int(model.jnt_type[j]) not in (HINGE, SLIDE):
            raise _not_scalar(model, source, j, name)
        names.append(name)
    if not names:
        raise InputError(source, "no joint", TREE, "name the file of a robot")
    return tuple(names)


def _not_scalar(model: mujoco.MjModel, source: str, joint: int, name: str) -> InputError:
    """The error for a ball or free joint: what can be done, and which joints can then be diagnosed."""
    body = int(model.jnt_bodyid[joint])
    if int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_FREE):
        own = {j for j in range(model.njnt) if _carries(model, body, int(model.jnt_bodyid[j]))}
        others = [name_of(model, mujoco.mjtObj.mjOBJ_JOINT, j) for j in range(model.njnt) if j not in own]
        label = name_of(model, mujoco.mjtObj.mjOBJ_BODY, body)
        advice = (
            f"remove body {label!r} in a copy of the model; {', '.join(others)} can then be diagnosed"
            if others and len(own) == 1 else "remove the joint in a copy of the model where the base stands still"
        )  # fmt: skip
        return InputError(source, f"joint {name!r} lets body {label!r} float", TREE, advice)
    return InputError(
        source, f"joint {name!r} is a ball joint", TREE,
        "fix it in a copy of the model where it stands still, or replace it by three hinges there; --joint chooses what is "
        "diagnosed, other joints follow the recording",
    )  # fmt: skip


def _carries(model: mujoco.MjModel, body: int, other: int) -> bool:
    """Whether a body is another one or carries it."""
    while other > 0 and other != body:
        other = int(model.body_parentid[other])
    return other == body
