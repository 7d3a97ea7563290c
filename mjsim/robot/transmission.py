"""What moves with what in a robot: joints tied to others by equalities, and the joint that each actuator drives.

Tied joints follow independent ones, q = T z + q0. An actuator at a joint or at a fixed tendon has the length
l = sum over joints of c_j q_j = g z_k + l0 where all its joints follow one independent joint k: g is its gear there.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.errors import InputError

__all__ = ["Transmission", "name_of", "ties", "transmission"]

TREE = "a fixed-base tree of hinges and slides"
AT_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


@dataclass(frozen=True, eq=False)
class Transmission:
    """Of each independent joint (m,): its actuator, -1 where there is none; gear: joint torque over actuator force; length: of
    the actuator at z = 0 [rad | m]."""

    actuators: tuple[int, ...]
    gear: np.ndarray
    length: np.ndarray


def name_of(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    """Name of an element, or what it is and its index."""
    return mujoco.mj_id2name(model, kind, index) or f"{kind.name.removeprefix('mjOBJ_').lower()} {index}"


def ties(model: mujoco.MjModel, source: str, dofs: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """T (n, m), q0 (n,) and the independent joints. Raises InputError for loops and for couplings that are no fixed ratio."""
    n, q0 = len(dofs), model.qpos0
    follows: dict[int, tuple[int, float, float]] = {}
    for e in range(model.neq):
        if not model.eq_active0[e]:
            continue
        kind = mujoco.mjtEq(int(model.eq_type[e]))
        if kind != mujoco.mjtEq.mjEQ_JOINT:
            raise _loop(model, source, dofs, e, kind)
        one, other, c = int(model.eq_obj1id[e]), int(model.eq_obj2id[e]), model.eq_data[e][:5]
        if np.any(c[2:] != 0):
            raise InputError(
                source, f"the equality that ties joint {dofs[one]!r} to another one is no fixed ratio", 'polycoef="a r 0 0 0"',
                "replace it by its slope about the recorded motion in a copy of the model, or fix the joint there",
            )  # fmt: skip
        if one in follows:
            raise InputError(source, f"two equalities tie joint {dofs[one]!r}", "one", "remove one in a copy of the model")
        if other < 0:
            follows[one] = -1, 0.0, float(q0[one] + c[0])
        else:
            follows[one] = other, float(c[1]), float(q0[one] + c[0] - c[1] * q0[other])
    independent = [j for j in range(n) if j not in follows]
    tie, rest = np.zeros((n, len(independent))), np.zeros(n)
    for j in range(n):
        at, ratio, shift, seen = j, 1.0, 0.0, {j}
        while at in follows:
            at, own, offset = follows[at]
            ratio, shift = ratio * own, shift + ratio * offset
            if at in seen:
                raise InputError(source, f"equalities tie joint {dofs[j]!r} to itself", TREE, "remove one in a copy of the model")
            seen.add(at)
        rest[j] = shift
        if at >= 0:
            tie[j, independent.index(at)] = ratio
    return tie, rest, independent


def _loop(model: mujoco.MjModel, source: str, dofs: tuple[str, ...], e: int, kind: mujoco.mjtEq) -> InputError:
    """The error for an equality that is not between joints; forces within a loop have no torque about joints outside it."""
    word, name = kind.name.removeprefix("mjEQ_").lower(), name_of(model, mujoco.mjtObj.mjOBJ_EQUALITY, e)
    if kind not in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
        return InputError(
            source, f"{name!r} is an equality of {word}s", TREE, "remove it, or fix what it ties, in a copy of the model"
        )
    bodies = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
    if int(model.eq_objtype[e]) == int(mujoco.mjtObj.mjOBJ_SITE):
        bodies = [int(model.site_bodyid[s]) for s in bodies]
    paths = [_path(model, b) for b in bodies]
    inside = paths[0] ^ paths[1]
    outside = [d for j, d in enumerate(dofs) if int(model.jnt_bodyid[j]) not in inside]
    works = f"remove it in a copy of the model; of a log of all joints {', '.join(outside)} can then be diagnosed, by --joint"
    return InputError(
        source, f"the equality {name!r} ({word}) closes a chain", TREE,
        works if outside else "no joint is outside the loop; model it as a tree in a copy",
    )  # fmt: skip


def _path(model: mujoco.MjModel, body: int) -> set[int]:
    """Bodies between the base and a body, itself included."""
    out = set()
    while body > 0:
        out.add(body)
        body = int(model.body_parentid[body])
    return out


def transmission(
    model: mujoco.MjModel, source: str, dofs: tuple[str, ...], tie: np.ndarray, rest: np.ndarray, independent: list[int]
) -> Transmission:
    """The actuator of each independent joint. Raises InputError for one that moves several of them, or none."""
    m = tie.shape[1]
    actuators, gear, length = [-1] * m, np.ones(m), np.zeros(m)
    for a in range(model.nactuator):
        if not model.actuator_ctrlnum[a]:
            _at_rest(model, source, a)
            continue
        name, arm = name_of(model, mujoco.mjtObj.mjOBJ_ACTUATOR, a), _arm(model, source, a)
        moved = np.flatnonzero(np.abs(arm @ tie) > 0.0)
        if len(moved) != 1:
            joints = ", ".join(dofs[j] for j in np.flatnonzero(arm))
            raise InputError(
                source, f"actuator {name!r} moves {joints or 'no joint'}, which follow {len(moved)} independent joints",
                "one independent joint an actuator, others tied to it by <equality><joint>",
                "tie them in a copy of the model, or remove the actuator there: the other joints can then be diagnosed",
            )  # fmt: skip
        k = int(moved[0])
        if actuators[k] >= 0:
            first = name_of(model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuators[k])
            raise InputError(
                source, f"actuators {first!r} and {name!r} both move joint {dofs[independent[k]]!r}", "one actuator a joint",
                "remove one in a copy of the model",
            )  # fmt: skip
        actuators[k], gear[k], length[k] = a, float((arm @ tie)[k]), float(arm @ rest)
    return Transmission(tuple(actuators), gear, length)


def _at_rest(model: mujoco.MjModel, source: str, a: int) -> None:
    """Raise InputError for an actuator without input that acts by itself."""
    if model.actuator_gainprm[a, 1:].any() or model.actuator_biasprm[a].any():
        raise InputError(
            source, f"actuator {name_of(model, mujoco.mjtObj.mjOBJ_ACTUATOR, a)!r} acts by itself", "actuators with an input",
            "remove it in a copy of the model: what acts of it is found as an effect",
        )  # fmt: skip


def _arm(model: mujoco.MjModel, source: str, a: int) -> np.ndarray:
    """c (n,): length of an actuator over the positions of the joints, of which it is a linear function."""
    kind, at, gear = mujoco.mjtTrn(int(model.actuator_trntype[a])), int(model.actuator_trnid[a, 0]), model.actuator_gear[a, 0]
    arm, name = np.zeros(model.njnt), name_of(model, mujoco.mjtObj.mjOBJ_ACTUATOR, a)
    if kind in AT_JOINT:
        arm[at] = gear
        return arm
    if kind != mujoco.mjtTrn.mjTRN_TENDON:
        raise InputError(
            source, f"actuator {name!r} drives no joint but a {kind.name.removeprefix('mjTRN_').lower()}",
            "actuators at joints or at fixed tendons",
            "name the joint that it drives in a copy of the model, or remove it there: the other joints can then be diagnosed",
        )  # fmt: skip
    first, tendon = int(model.tendon_adr[at]), name_of(model, mujoco.mjtObj.mjOBJ_TENDON, at)
    for w in range(first, first + int(model.tendon_num[at])):
        if int(model.wrap_type[w]) != int(mujoco.mjtWrap.mjWRAP_JOINT):
            raise InputError(
                source, f"actuator {name!r} pulls the spatial tendon {tendon!r}", "a fixed tendon, whose length is linear in "
                "the joints", "replace it by <fixed> with the lever about the recorded motion, or remove the actuator in a copy",
            )  # fmt: skip
        arm[int(model.wrap_objid[w])] += gear * float(model.wrap_prm[w])
    if float(model.tendon_frictionloss[at]) > 0.0:
        raise InputError(
            source, f"tendon {tendon!r} has frictionloss", "dry friction at joints", "give it to the joint that moves"
        )
    return arm
