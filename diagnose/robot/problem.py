"""The regression of a robot: one row a joint, linear in the robot's own parameters and in the effects' coefficients.

    y_j(t) = A_j(t) theta + sum over terms at j of C(t; shape) c + e_j(t)

theta: inertial parameters of all links, and of each joint armature, damping, and the dry friction and stiffness that the
file has.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.robot.laws import Law, Row, laws_for
from diagnose.robot.motion import RobotMotion
from mjsim.robot.inertia import NAMES, SIZE
from mjsim.robot.model import Robot
from mjsim.robot.rows import link_rows

__all__ = ["Part", "Problem", "Term", "build"]

NEAR = 2  # joints further apart in the chain have no gears in common
JOINT_PARAMETERS = ("armature", "damping", "frictionloss", "stiffness")


@dataclass(frozen=True)
class Term:
    """One effect at one joint (index among the robot's), with its shape."""

    joint: int
    law: Law
    shape: float

    @property
    def key(self) -> tuple[int, str]:
        """Joint and law."""
        return self.joint, self.law.key


@dataclass(frozen=True, eq=False)
class Part:
    """Samples of one joint's row that are fitted, or that are held out.

    A (n, P): the robot's own columns; y (n,): the torque less that of the nominal theta; measured (n,): the torque; at
    (n,): position on the time axis of all recordings [samples of the coarse grid]; run (n,): which recording.
    """

    A: np.ndarray
    y: np.ndarray
    measured: np.ndarray
    at: np.ndarray
    run: np.ndarray


@dataclass(frozen=True, eq=False)
class Problem:
    """All rows; parameters by name with nominal value and prior scale (one standard deviation); regressors on the fine grid."""

    robot: Robot
    motions: tuple[RobotMotion, ...]
    joints: tuple[int, ...]
    names: tuple[str, ...]
    nominal: np.ndarray
    scale: np.ndarray
    fitted: dict[int, Part]
    held: dict[int, Part]
    laws: dict[int, tuple[Law, ...]]
    links: tuple[np.ndarray, ...]
    dt: float

    @functools.cached_property
    def grams(self) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Scaled columns B = A scale (n, P), B'B (P, P) and B'y (P,) of each row."""
        out = {}
        for j in self.joints:
            B = self.fitted[j].A * self.scale
            out[j] = B, B.T @ B, B.T @ self.fitted[j].y
        return out

    @functools.cached_property
    def own_friction(self) -> dict[int, int]:
        """Index in theta of the dry friction that the file has, by joint."""
        return {j: self.names.index(n) for j in self.joints if (n := f"{self.robot.joints[j]}.frictionloss") in self.names}

    def rows(self, theta: np.ndarray) -> list[dict[int, Row]]:
        """Signals of every joint of every recording; the load by the links of theta."""
        out = []
        size = len(self.robot.links) * SIZE
        for motion, Y in zip(self.motions, self.links, strict=True):
            load = np.einsum("nmk,k->nm", Y.reshape(*Y.shape[:2], -1), theta[:size])
            out.append({j: _row(self.robot, motion, j, self.joints, load[:, j]) for j in self.joints})
        return out

    def columns(self, term: Term, rows: Sequence[dict[int, Row]]) -> tuple[np.ndarray, np.ndarray]:
        """Columns (n, k) of a term on the fitted and on the held-out samples of its joint's row."""
        return self.all_columns([term], rows)[term]

    def all_columns(self, terms: Sequence[Term], rows: Sequence[dict[int, Row]]) -> dict[Term, tuple[np.ndarray, np.ndarray]]:
        """Columns of many terms, filtered together."""
        out: dict[Term, list[list[np.ndarray]]] = {t: [[], []] for t in terms}
        for joint, passes in dict.fromkeys((t.joint, t.law.passes) for t in terms):
            alike = [t for t in terms if (t.joint, t.law.passes) == (joint, passes)]
            for motion, row in zip(self.motions, rows, strict=True):
                each = [t.law.columns(row[joint], t.shape) for t in alike]
                C = motion.thinned(motion.low_passed(np.column_stack([c for columns in each for c in columns]), passes))
                at = 0
                for t, columns in zip(alike, each, strict=True):
                    own = C[:, at : at + len(columns)]
                    out[t][0].append(own[motion.counts[:, joint] & ~motion.held])
                    out[t][1].append(own[motion.counts[:, joint] & motion.held])
                    at += len(columns)
        return {t: (np.concatenate(a), np.concatenate(b)) for t, (a, b) in out.items()}


def _row(robot: Robot, motion: RobotMotion, j: int, joints: Sequence[int], load: np.ndarray) -> Row:
    from diagnose.robot.motion import derivative

    torque = motion.torque[:, j]
    others = {robot.joints[k]: (motion.dz[:, k], motion.torque[:, k]) for k in joints if 0 < abs(k - j) <= NEAR}
    rate = derivative(torque[:, None], motion.dt)[:, 0]
    return Row(motion.z[:, j], motion.dz[:, j], motion.time - motion.time[0], load, torque, rate, others)


def build(robot: Robot, motions: Sequence[RobotMotion], joints: Sequence[int], only: Sequence[str] = ()) -> Problem:
    """The regression of these joints over all recordings."""
    names, nominal = _parameters(robot, joints)
    links = tuple(link_rows(robot, *m.of_links) for m in motions)
    fitted: dict[int, list[Part]] = {j: [] for j in joints}
    held: dict[int, list[Part]] = {j: [] for j in joints}
    offset = 0
    for run, (motion, Y) in enumerate(zip(motions, links, strict=True)):
        index = np.arange(len(motion.counts))
        for j in joints:
            A, known = _columns(robot, motion, Y, j, names)
            y = motion.thinned(motion.torque[:, j]) - known
            for out, keep in ((fitted, motion.counts[:, j] & ~motion.held), (held, motion.counts[:, j] & motion.held)):
                n = int(keep.sum())
                out[j].append(Part(A[keep], (y - A @ nominal)[keep], y[keep], offset + index[keep], np.full(n, run)))
        offset += 2 * len(index)
    parts = [{j: _joined(parts[j]) for j in joints} for parts in (fitted, held)]
    problem = Problem(
        robot, tuple(motions), tuple(joints), names, nominal,
        _scales(robot, joints, parts[0], names, nominal), parts[0], parts[1],
        {}, links, motions[0].dt * motions[0].every,
    )  # fmt: skip
    estimation = [r for r, m in zip(problem.rows(nominal), motions, strict=True) if m.role == "estimation"]
    for j in joints:
        problem.laws[j] = laws_for(_longest([r[j] for r in estimation]), robot.motions[j], float(robot.gear[j]), only)
    return problem


def _longest(rows: Sequence[Row]) -> Row:
    """The row of the recording in which the joint travels furthest."""
    return max(rows, key=lambda r: float(np.ptp(r.q)))


def _joined(parts: Sequence[Part]) -> Part:
    return Part(*(np.concatenate([getattr(p, k) for p in parts]) for k in ("A", "y", "measured", "at", "run")))


def _parameters(robot: Robot, joints: Sequence[int]) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and nominal values: links first, then joint by joint."""
    names = [f"{link}.{p}" for link in robot.link_names for p in NAMES]
    values = list(robot.nominal.ravel())
    for j in joints:
        d = robot.leading(j)
        own = zip(JOINT_PARAMETERS, (robot.armature, robot.damping, robot.frictionloss, robot.stiffness), strict=True)
        for kind, array in own:
            value = float(array @ robot.tie[:, j] ** 2) if kind in ("armature", "damping") else float(array[d])
            if kind in ("armature", "damping") or value > 0:
                names.append(f"{robot.joints[j]}.{kind}")
                values.append(value)
    return tuple(names), np.array(values)


def _columns(robot: Robot, motion: RobotMotion, Y: np.ndarray, j: int, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """The robot's own columns (M, P) in the row of joint j, and the torque (M,) that is known: a payload's."""
    low = motion.low_passed
    flat = low(Y[:, j].reshape(len(Y), -1))
    A = np.zeros((len(motion.counts), len(names)))
    A[:, : flat.shape[1]] = motion.thinned(flat)
    d, joint = robot.leading(j), robot.joints[j]
    own: dict[str, Callable[[], np.ndarray]] = {
        "armature": lambda: low(motion.ddz[:, j]),
        "damping": lambda: low(motion.dz[:, j]),
        "frictionloss": lambda: low(np.sign(motion.dz[:, j]), 2),
        "stiffness": lambda: low(motion.z[:, j] - robot.spring[d]),
    }
    for kind, column in own.items():
        if f"{joint}.{kind}" in names:
            A[:, names.index(f"{joint}.{kind}")] = motion.thinned(column())
    known = np.zeros(len(A))
    if motion.payload is not None:
        link, phi = motion.payload
        known = motion.thinned(low(Y[:, j, link] @ phi))
    return A, known


def _scales(robot: Robot, joints: Sequence[int], parts: dict[int, Part], names: Sequence[str], nominal: np.ndarray) -> np.ndarray:
    """Prior standard deviation of each parameter.

    A link may be wrong by its own mass, or by the mean mass of a link where it is lighter, at a distance as far as its own
    matter or the next joint lies; a rotor and a damping by what the joint's torque would be for its motion.
    """
    m = robot.model
    scale = np.empty(len(names))
    masses = robot.nominal[:, 0]
    for i, b in enumerate(robot.links):
        phi = robot.nominal[i]
        size = np.sqrt(0.5 * np.sum(phi[4:7]) / max(phi[0], 1e-12))
        reach = [float(np.linalg.norm(m.body_pos[c])) for c in range(1, m.nbody) if m.body_parentid[c] == b]
        length = max([float(size), *reach])
        mass = max(float(masses[i]), float(np.mean(masses)))
        scale[i * SIZE : (i + 1) * SIZE] = [mass, *[mass * length] * 3, *[mass * length**2] * 6]
    for j in joints:
        joint, part = robot.joints[j], parts[j]
        torque = float(np.std(part.measured))
        for kind in JOINT_PARAMETERS:
            name = f"{joint}.{kind}"
            if name in names:
                k = names.index(name)
                per = float(np.sqrt(np.mean(part.A[:, k] ** 2))) + 1e-300
                scale[k] = max(torque / per, float(nominal[k]))
    return scale
