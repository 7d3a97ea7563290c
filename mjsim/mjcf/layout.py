"""What a compiled model is made of, as rows over its degrees of freedom.

Every mass moves with one *row* r: its coordinate is r q, its kinetic energy m (r q')^2 / 2. Every spring, damper and friction
acts on one row too. Ties (equalities, closed slack) restrict q' to N z. A model is a single-axis chain when, in z, the mass rows
fall on as many directions as z has, and every passive element joins two of them in one path that starts at the actuator.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.errors import InputError, nearest
from mjsim.mjcf.drive_laws import DriveLaw, law_of, refused_law
from mjsim.mjcf.servo import read_servo
from mjsim.quantity import Motion
from mjsim.servo import Servo

__all__ = ["Drive", "Layout", "Mass", "Passive", "lay_out", "outside", "parallel"]

_TOL, TORQUE = 1e-9, DriveLaw(1.0)
WORKS = "simgap render still works on it"


def outside(where: object, what: str, todo: str) -> InputError:
    """The one line for a model that is no single-axis chain: what is outside, and what still works."""
    return InputError(where, what, "a single-axis chain", f"{todo}; {WORKS}")


@dataclass(frozen=True)
class Mass:
    """An inertia on a row; ``lever`` is the share that comes from the mass (of a hinge body, whose centre stands off the axis).

    ``kind`` is body, or joint, tendon, actuator for an armature; ``id`` is its index there.
    """

    kind: str
    id: int
    name: str
    row: np.ndarray
    value: float
    lever: float = 0.0


@dataclass(frozen=True)
class Passive:
    """A spring, damper and dry friction on a row: force -(k x + k2 x^2 + k3 x^3) - (d v + d2 v |v| + d3 v^3) - f sign v.

    ``gap`` is the width of a dead band of its spring, ``rest`` where it is at rest. ``kind`` is joint, tendon or actuator.
    """

    kind: str
    id: int
    name: str
    row: np.ndarray
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    friction: float
    gap: float = 0.0
    rest: float = 0.0

    @property
    def acts(self) -> bool:
        """Whether it does anything."""
        return any(self.stiffness) or any(self.damping) or self.friction > 0


@dataclass(frozen=True)
class Drive:
    """The bound actuator: its row (gear included), its gain (1 per unit of force of a servo), its servo and its law.

    Of a model without actuators: ``id`` -1 and the row of its joint.
    """

    id: int
    name: str
    row: np.ndarray
    gain: float
    servo: Servo | None = None
    law: DriveLaw = TORQUE


@dataclass(frozen=True)
class Layout:
    """Rows of a model (nv columns), its ties and its closed slack.

    base (nv, nz): q' = base z. slack: joint -> width of its range.
    """

    model: mujoco.MjModel
    masses: tuple[Mass, ...]
    passives: tuple[Passive, ...]
    drive: Drive
    base: np.ndarray
    slack: dict[int, float] = dataclasses.field(default_factory=dict)


def parallel(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two rows have one direction (of either sign)."""
    na, nb = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return na > 0 and nb > 0 and abs(abs(float(a @ b)) - na * nb) <= _TOL * na * nb


def lay_out(model: mujoco.MjModel, data: mujoco.MjData, source: object, actuator: str | None, frozen: tuple[str, ...]) -> Layout:
    """Read the rows of a model. ``frozen`` names joints and passive elements that are to be seen as not there."""
    _only_hinges_and_slides(model, source)
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    tendons = _tendon_rows(model, data)
    still = [_unit(model, j) for j in range(model.njnt) if model.joint(j).name in frozen]
    drive = _drive(model, source, actuator, tendons, still)
    masses = (*_body_masses(model, data, source), *_armatures(model, tendons))
    passives = _passives(model, source, tendons, frozen)
    ties = _ties(model, source, tendons) + still
    base = _null(ties, model.nv)
    slack = _slack(model, masses, passives, drive, base)
    base = _null(ties + [_unit(model, j) for j in slack], model.nv)
    layout = Layout(model, masses, passives, drive, base, slack)
    _verify_mass(layout, data, source)
    return layout


def _only_hinges_and_slides(model: mujoco.MjModel, source: object) -> None:
    for j in range(model.njnt):
        kind = mujoco.mjtJoint(int(model.jnt_type[j]))
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            name = "free" if kind == mujoco.mjtJoint.mjJNT_FREE else "ball"
            raise outside(source, f"joint {_label(model.joint(j).name, j)} is a {name} joint", "fix that body or give it a hinge")
    if model.nv == 0:
        raise outside(source, "nothing moves: there is no joint", "give the axis a hinge or slide joint")
    if model.nflex:
        raise outside(source, "it has flexible bodies", "remove them")


def _label(name: str, index: int) -> str:
    return repr(name) if name else f"number {index} (unnamed)"


def _unit(model: mujoco.MjModel, joint: int) -> np.ndarray:
    row = np.zeros(model.nv)
    row[model.jnt_dofadr[joint]] = 1.0
    return row


def _null(ties: list[np.ndarray], nv: int) -> np.ndarray:
    """Basis (nv, nz) of the motions that the ties leave: a tie gives its largest coordinate by the others: ratios stay exact."""
    base = np.eye(nv)
    for tie in ties:
        row = tie @ base
        pivot = int(np.argmax(np.abs(row)))
        if abs(row[pivot]) < _TOL * np.linalg.norm(tie):
            continue  # follows from the ties before
        rest = np.delete(np.arange(base.shape[1]), pivot)
        base = base[:, rest] - np.outer(base[:, pivot], row[rest] / row[pivot])
    return base


def _tendon_rows(model: mujoco.MjModel, data: mujoco.MjData) -> list[np.ndarray | None]:
    """Constant Jacobian rows of fixed tendons; None for spatial ones."""
    rows: list[np.ndarray | None] = []
    for t in range(model.ntendon):
        start, count = int(model.tendon_adr[t]), int(model.tendon_num[t])
        if any(int(model.wrap_type[w]) != mujoco.mjtWrap.mjWRAP_JOINT for w in range(start, start + count)):
            rows.append(None)
            continue
        row = np.zeros(model.nv)
        for w in range(start, start + count):
            row[model.jnt_dofadr[model.wrap_objid[w]]] += model.wrap_prm[w]
        rows.append(row)
    return rows


def _actuator_row(model: mujoco.MjModel, a: int, tendons: list[np.ndarray | None]) -> np.ndarray | None:
    """Transmission row (gear included), None when it is not constant."""
    kind, target, gear = (
        mujoco.mjtTrn(int(model.actuator_trntype[a])),
        int(model.actuator_trnid[a, 0]),
        float(model.actuator_gear[a, 0]),
    )
    if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        return gear * _unit(model, target)
    if kind == mujoco.mjtTrn.mjTRN_TENDON:
        row = tendons[target]
        return None if row is None else gear * row
    return None


def _drive(
    model: mujoco.MjModel, source: object, wanted: str | None, tendons: list[np.ndarray | None], still: list[np.ndarray]
) -> Drive:
    names = [model.actuator(a).name for a in range(model.nactuator)]
    inputs = [a for a in range(model.nactuator) if model.actuator_ctrlnum[a] > 0]
    choices = ", ".join(_label(names[a], a) for a in inputs) or "none"
    if not wanted and not inputs:
        return Drive(-1, "", _undriven_row(model, source, tendons, still), 1.0)
    if wanted is None:
        if len(inputs) != 1:
            raise InputError(
                source, f"{len(inputs)} actuators and none bound (there are: {choices})", "one driven joint",
                "add an actuator" if not inputs else 'bind one: [model] actuator = "..." in the TOML beside the model',
            )  # fmt: skip
        chosen = inputs[0]
    else:
        found = [a for a in inputs if names[a] == wanted]
        if not found:
            there = [names[a] for a in inputs if names[a]]
            raise InputError(
                source, f"no actuator {wanted!r}", f"one of: {choices}", nearest(wanted, there, "bind one that is there")
            )
        chosen = found[0]
    where = f"actuator {_label(names[chosen], chosen)}"
    row = _actuator_row(model, chosen, tendons)
    if row is None or not np.any(row):
        raise outside(source, f"{where} does not act on a joint or a fixed tendon", "drive the joint")
    refused = refused_law(model, chosen)
    if refused is not None:
        raise outside(source, f"{where} {refused[0]}", refused[1])
    servo = read_servo(model, chosen, source, names[chosen])
    law = law_of(model, chosen)
    return Drive(chosen, names[chosen], row, 1.0 if servo else law.gain, servo, law)


def _undriven_row(model: mujoco.MjModel, source: object, tendons: list[np.ndarray | None], still: list[np.ndarray]) -> np.ndarray:
    """Row of the joint that stands for a model without actuators: the only one that ties and the joints ``still`` leave free."""
    base = _null(_ties(model, source, tendons) + still, model.nv)
    if base.shape[1] != 1:
        raise InputError(
            source, f"0 actuators and none bound (there are: none), and {base.shape[1]} joints move", "one driven joint",
            "add an actuator to the joint that the log is of, or fix the other joints",
        )  # fmt: skip
    return _unit(model, int(model.dof_jntid[int(np.argmax(np.abs(base[:, 0])))]))


def _body_masses(model: mujoco.MjModel, data: mujoco.MjData, source: object) -> list[Mass]:
    """Every moving body as an inertia on the row of the joints that carry it."""
    out = []
    jacp, jacr = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for b in range(1, model.nbody):
        mujoco.mj_jacBodyCom(model, data, jacp, jacr, b)
        where = f"body {_label(model.body(b).name, b)}"
        mass = float(model.body_mass[b])
        lever = 0.0
        turning = np.linalg.norm(jacr) > _TOL
        moving = np.linalg.norm(jacp) > _TOL
        if not turning and not moving:
            continue
        turn, axis = _rank_one(jacr) if turning else (np.zeros(model.nv), np.zeros(3))
        move, arm = _rank_one(jacp) if moving else (np.zeros(model.nv), np.zeros(3))
        if turn is None or move is None or (turning and moving and not parallel(turn, move)):
            raise outside(source, f"{where} turns and moves about more than one axis", "keep the joints of the axis on one line")
        if turning:
            rotation = data.ximat[b].reshape(3, 3)
            tensor = rotation @ np.diag(model.body_inertia[b]) @ rotation.T
            value = float(axis @ tensor @ axis)
            row = turn
            if moving:
                scale = float(np.linalg.norm(move) / np.linalg.norm(turn))
                lever = mass * (scale * float(np.linalg.norm(arm))) ** 2
                value += lever
        else:
            row, value = move, mass * float(arm @ arm)
            lever = value
        out.append(Mass("body", b, model.body(b).name, row, value, lever))
    return out


def _rank_one(jacobian: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """Row and unit direction of a Jacobian (3, nv) of rank one, the row's last entry positive; no row when its rank is higher."""
    last = int(np.flatnonzero(np.linalg.norm(jacobian, axis=0) > _TOL * np.linalg.norm(jacobian))[-1])
    direction = jacobian[:, last] / np.linalg.norm(jacobian[:, last])
    row = direction @ jacobian
    if np.linalg.norm(jacobian - np.outer(direction, row)) > _TOL * np.linalg.norm(jacobian):
        return None, direction
    row[np.abs(row) < _TOL * np.max(np.abs(row))] = 0.0
    return row, direction


def _armatures(model: mujoco.MjModel, tendons: list[np.ndarray | None]) -> list[Mass]:
    of_joints = ((j, float(model.dof_armature[model.jnt_dofadr[j]])) for j in range(model.njnt))
    out = [Mass("joint", j, model.joint(j).name, _unit(model, j), armature) for j, armature in of_joints if armature]
    own = model.actuator_armature
    rows = ((a, _actuator_row(model, a, tendons)) for a in map(int, np.flatnonzero(own)))
    out += [Mass("actuator", a, model.actuator(a).name, r, float(own[a])) for a, r in rows if r is not None]
    for t, row in enumerate(tendons):
        if row is not None and model.tendon_armature[t]:
            out.append(Mass("tendon", t, model.tendon(t).name, row, float(model.tendon_armature[t])))
    return out


def _passives(
    model: mujoco.MjModel, source: object, tendons: list[np.ndarray | None], frozen: tuple[str, ...]
) -> tuple[Passive, ...]:
    out = []
    for j in range(model.njnt):
        dof = int(model.jnt_dofadr[j])
        out.append(
            Passive(
                "joint", j, model.joint(j).name, _unit(model, j),
                (float(model.jnt_stiffness[j]), *map(float, model.jnt_stiffnesspoly[j])),
                (float(model.dof_damping[dof]), *map(float, model.dof_dampingpoly[dof])),
                float(model.dof_frictionloss[dof]), rest=float(model.qpos_spring[model.jnt_qposadr[j]]),
            )
        )  # fmt: skip
    for t, row in enumerate(tendons):
        name = model.tendon(t).name
        low, high = map(float, model.tendon_lengthspring[t])
        item = Passive(
            "tendon", t, name, np.zeros(model.nv) if row is None else row,
            (float(model.tendon_stiffness[t]), *map(float, model.tendon_stiffnesspoly[t])),
            (float(model.tendon_damping[t]), *map(float, model.tendon_dampingpoly[t])),
            float(model.tendon_frictionloss[t]), high - low, (high + low) / 2,
        )  # fmt: skip
        if row is None and item.acts:
            raise outside(source, f"tendon {_label(name, t)} is spatial and has forces of its own", "use a fixed tendon")
        out.append(item)
    for a in range(model.nactuator):
        damping = (float(model.actuator_damping[a]), *map(float, model.actuator_dampingpoly[a]))
        if any(damping):
            arow = _actuator_row(model, a, tendons)
            if arow is None:
                raise outside(source, f"actuator {_label(model.actuator(a).name, a)} damps no joint", "damp the joint")
            out.append(Passive("actuator", a, model.actuator(a).name, arow, (0.0, 0.0, 0.0), damping, 0.0))
    return tuple(p for p in out if p.acts and p.name not in frozen)


def _ties(model: mujoco.MjModel, source: object, tendons: list[np.ndarray | None]) -> list[np.ndarray]:
    """Rows c with c q' = 0 of the active equalities."""
    out = []
    for e in range(model.neq):
        if not model.eq_active0[e]:
            continue
        where = f"equality {_label(model.equality(e).name, e)}"
        kind = mujoco.mjtEq(int(model.eq_type[e]))
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            rows = [_unit(model, int(i)) if i >= 0 else None for i in (model.eq_obj1id[e], model.eq_obj2id[e])]
        elif kind == mujoco.mjtEq.mjEQ_TENDON:
            rows = [tendons[int(i)] if i >= 0 else None for i in (model.eq_obj1id[e], model.eq_obj2id[e])]
        else:
            raise outside(source, f"{where} ties bodies in space", "tie the joints: <equality><joint .../>")
        if rows[0] is None:
            raise outside(source, f"{where} ties a spatial tendon", "tie the joints")
        if np.any(model.eq_data[e, 2:5]) and rows[1] is not None:
            raise outside(source, f"{where} has a polycoef of degree above one", 'use polycoef="offset ratio 0 0 0"')
        out.append(rows[0] - float(model.eq_data[e, 1]) * rows[1] if rows[1] is not None else rows[0])
    return out


def _slack(
    model: mujoco.MjModel, masses: tuple[Mass, ...], passives: tuple[Passive, ...], drive: Drive, base: np.ndarray
) -> dict[int, float]:
    """Slack joints: limited, free within the limits, between two moving parts, so that closing them stops nothing else."""
    out: dict[int, float] = {}
    held = [p.row for p in passives] + [m.row for m in masses if m.kind == "body"] + [drive.row]
    own = {p.id for p in passives if p.kind == "joint"}
    for j in range(model.njnt):
        unit = _unit(model, j)
        if not model.jnt_limited[j] or j in own or np.linalg.norm(unit @ base) < _TOL:
            continue
        closed = base @ _null([unit @ base], base.shape[1])
        before = [np.linalg.norm(r @ base) > _TOL * np.linalg.norm(r) for r in held]
        after = [np.linalg.norm(r @ closed) > _TOL * np.linalg.norm(r) for r in held]
        if closed.shape[1] and before == after:
            low, high = map(float, model.jnt_range[j])
            out[j] = high - low
            base = closed
    return out


def _verify_mass(layout: Layout, data: mujoco.MjData, source: object) -> None:
    """The rows must make up MuJoCo's own inertia matrix, here and at another angle."""
    model = layout.model
    rebuilt = sum((m.value * np.outer(m.row, m.row) for m in layout.masses), np.zeros((model.nv, model.nv)))
    full = np.zeros((model.nv, model.nv))
    for shift in (0.0, 0.7):
        # every body turned about its own joint axis, whatever the ties say
        data.qpos[:] = model.qpos0 + shift
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        if np.max(np.abs(full - rebuilt)) > 1e-6 * np.max(np.abs(full)):
            raise outside(
                source, "its inertia depends on the pose or couples the joints", "keep the joints of the axis on one line"
            )


def motion_of(model: mujoco.MjModel, joint: int) -> Motion:
    """Hinge or slide."""
    return Motion.SLIDE if int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_SLIDE else Motion.HINGE
