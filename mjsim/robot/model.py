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

__all__ = ["Robot", "load_robot", "robot_from"]

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, eq=False)
class Robot:
    """A fixed-base tree with n degrees of freedom, m of them independent, and L links.

    dofs: names of all n joints in MuJoCo's order; joints: names of the m independent ones; tie (n, m), rest (n,): q = tie z
    + rest;
    gear (m,): joint torque over recorded torque; driven (m,): whether an actuator drives it; links: body ids (L,);
    nominal (L, 10): inertial parameters of a link with all that is fixed to it; fixed (L, 10): of what is fixed to it alone.
    armature, damping, frictionloss, stiffness (n,): as in the file; spring (n,): springref; ranges (n, 2): joint limits, infinite
    where there are none; motions: hinge or slide of each independent joint.
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

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links."""
        return tuple(_name(self.model, mujoco.mjtObj.mjOBJ_BODY, b) for b in self.links)

    def leading(self, joint: int) -> int:
        """Index among all dofs of an independent joint."""
        return self.dofs.index(self.joints[joint])

    def link_of(self, body: str) -> tuple[int, np.ndarray, np.ndarray]:
        """Link that a body belongs to, and the body's position and orientation in its frame. Raises InputError."""
        names = [_name(self.model, mujoco.mjtObj.mjOBJ_BODY, b) for b in range(self.model.nbody)]
        if body not in names:
            raise InputError(
                self.source, f"no body {body!r}", f"one of {', '.join(names[1:])}", nearest(body, names[1:], "correct the name")
            )
        at = names.index(body)
        root = int(self.model.body_weldid[at])
        if root not in self.links:
            raise InputError(self.source, f"body {body!r} does not move", "a body of the arm", "correct the name")
        return self.links.index(root), *_pose(self.model, at, root)


def _name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    return mujoco.mj_id2name(model, kind, index) or f"{kind.name.removeprefix('mjOBJ_').lower()} {index}"


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
    """The robot of a compiled model. Raises InputError for ball and free joints, closed chains and tendon drives."""
    dofs = _dofs(model, source)
    tie, rest, independent = _ties(model, source, dofs)
    gear, driven = _drives(model, source, dofs, independent)
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
    motions = tuple(Motion.HINGE if model.jnt_type[j] == HINGE else Motion.SLIDE for j in independent)
    return Robot(
        source, model, dofs, tuple(dofs[j] for j in independent), tie, rest, gear, driven, links, nominal, fixed,
        model.dof_armature.copy(), model.dof_damping.copy(), model.dof_frictionloss.copy(), model.jnt_stiffness.copy(),
        model.qpos_spring.copy(), ranges, motions,
    )  # fmt: skip


def _dofs(model: mujoco.MjModel, source: str) -> tuple[str, ...]:
    names = []
    for j in range(model.njnt):
        name = _name(model, mujoco.mjtObj.mjOBJ_JOINT, j)
        if int(model.jnt_type[j]) not in (HINGE, SLIDE):
            kind = "free" if int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_FREE) else "ball"
            raise InputError(
                source, f"joint {name!r} is a {kind} joint", "a fixed-base tree of hinges and slides",
                "fix it in a copy of the model, and diagnose the joints that are left",
            )  # fmt: skip
        names.append(name)
    if not names:
        raise InputError(source, "no joint", "a fixed-base tree of hinges and slides", "name the file of a robot")
    return tuple(names)


def _ties(model: mujoco.MjModel, source: str, dofs: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """tie (n, m), rest (n,) and the independent joints."""
    n = len(dofs)
    follows: dict[int, tuple[int, float, float]] = {}
    for e in range(model.neq):
        if not model.eq_active0[e]:
            continue
        kind = mujoco.mjtEq(int(model.eq_type[e]))
        if kind != mujoco.mjtEq.mjEQ_JOINT:
            raise InputError(
                source, f"equality {e} of kind {kind.name.removeprefix('mjEQ_').lower()} closes a chain or couples tendons",
                "a tree, with joints tied to each other at most",
                "diagnose one joint of a model without it, the others following the recording",
            )  # fmt: skip
        one, other = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        c = model.eq_data[e][:5]
        if other < 0 or np.any(c[2:] != 0) or one in follows or other in follows:
            raise InputError(
                source, f"the equality at joint {dofs[one]!r} is not a fixed ratio to an independent joint",
                "polycoef=\"a r 0 0 0\"",
                "remove it in a copy of the model",
            )  # fmt: skip
        q0 = model.qpos0
        follows[one] = other, float(c[1]), float(q0[one] + c[0] - c[1] * q0[other])
    independent = [j for j in range(n) if j not in follows]
    tie, rest = np.zeros((n, len(independent))), np.zeros(n)
    for j in range(n):
        other, ratio, shift = follows.get(j, (j, 1.0, 0.0))
        tie[j, independent.index(other)] = ratio
        rest[j] = shift
    return tie, rest, independent


def _drives(model: mujoco.MjModel, source: str, dofs: tuple[str, ...], independent: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Gear and whether it is driven, of each independent joint."""
    gear, driven = np.ones(len(independent)), np.zeros(len(independent), bool)
    for a in range(model.nu):
        name = _name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, a)
        kind = mujoco.mjtTrn(int(model.actuator_trntype[a]))
        if kind not in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
            raise InputError(
                source, f"actuator {name!r} drives no joint but a {kind.name.removeprefix('mjTRN_').lower()}",
                "actuators at joints", "name the joint that it drives in a copy of the model",
            )  # fmt: skip
        joint = int(model.actuator_trnid[a, 0])
        if joint not in independent or driven[independent.index(joint)]:
            raise InputError(
                source, f"actuator {name!r} drives joint {dofs[joint]!r}, which another joint or actuator moves",
                "one actuator at an independent joint", "remove one in a copy of the model",
            )  # fmt: skip
        gear[independent.index(joint)] = model.actuator_gear[a, 0]
        driven[independent.index(joint)] = True
    return gear, driven
