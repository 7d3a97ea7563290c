"""A joint that is not in the log: does what its neighbours' torques leave show that it moved?

It is taken to be held at q0. If it moved by d(t), the torque of every joint j beside it is off by

    dtau_j = dtau_j/dq d + dtau_j/dq' d' + dtau_j/dq'' d'',

one unknown function in several rows. d is a cubic spline of `KNOT` seconds, fitted by Gauss-Newton with the numbers that a
diagnosis leaves free beside it. The share of the residual that it explains is compared with functions that couple otherwise: the
same derivatives at other times, with rows exchanged and turned over.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.check.types import Problem, Severity
from mjsim.quantity import Motion
from mjsim.robot.drives import joint_drives
from mjsim.robot.inertia import point_mass
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.rows import link_rows, nominal_torque

__all__ = ["Absent", "moved_unseen", "not_logged"]

KNOT = 0.25  # [s]: a motion of up to 2 Hz
BIN = 0.1  # [s]: means over it are compared, of which the motion up to 2 Hz takes at most a tenth
LONGEST = 20.0  # [s] of a log that are looked at
DRAWS = 99  # couplings that are no joint's: none of them explains as much by chance at a level of 1 %
MOST = 0.5  # of the residual: what explains more of it than all else together
ROUNDS = 4  # of Gauss-Newton
STEP = 1e-5  # [rad | m, per second, per second squared] of the differences
NOTHING = 1e-9  # of the largest singular value: what rounding leaves of numbers that the motion does not show
FEWEST = 40  # means: four seconds
SHOWN = 0.1  # of the joint that shows it best: joints that are named beside it


@dataclass(frozen=True, eq=False)
class Absent:
    """A joint that is not in the log and moved: its name, the share of what the others leave that its motion explains, that
    motion (K,) [rad | m] and the joints whose torques show it."""

    joint: str
    share: float
    motion: np.ndarray
    shown_by: tuple[str, ...]


def not_logged(robot: Robot, r: RobotRecording, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> list[Problem]:
    """A problem for each joint that is not in the log: it is taken to be held, and to be fixed where it moved.

    z, dz, ddz (N, m): low-passed motion of the independent joints.
    """
    if np.sum(robot.driven) < 2:  # an axis, whose further joints are couplings
        return []
    found, out = moved_unseen(robot, r, z, dz, ddz), []
    for name, at in r.held_at:
        unit = "rad" if robot.motions[robot.joints.index(name)] is Motion.HINGE else "m"
        if found is not None and name == found.joint:
            out.append(
                Problem(
                    f"{name}.angle", "not_logged", found.share, "1",
                    f"{name} is not in the log and is taken to be held at {at:.4g} {unit}, but it moved or stood elsewhere: its "
                    f"motion explains {100 * found.share:.0f} % of what the model leaves of {', '.join(found.shown_by)}. Its "
                    "absence is the likely cause of what is found there.",
                    f"log {name}.angle_{unit}, or hold it there while the others move", Severity.FIX,
                )
            )  # fmt: skip
        else:
            out.append(
                Problem(
                    f"{name}.angle", "not_logged", at, unit,
                    f"{name} is not in the log: it is taken to be held at {at:.4g} {unit}, its position in the model.",
                    f"log {name}.angle_{unit}, or give the model the position at which it was held (ref of the joint)",
                    Severity.LIMITS,
                )
            )  # fmt: skip
    return out


def moved_unseen(robot: Robot, r: RobotRecording, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> Absent | None:
    """The joint, of those that are not in the log, whose motion the torques of the others show; None where none does.

    z, dz, ddz (N, m): low-passed motion of the independent joints, those that are not in the log held.
    """
    lacking = [robot.joints.index(name) for name, _ in r.held_at]
    count = min(len(r), round(LONGEST / r.dt))
    rows = _rows(robot, r, z[:count], dz[:count], ddz[:count]) if lacking else None
    if rows is None or len(rows.joints) < 2:
        return None
    found = [x for x in (_tried(robot, rows, k) for k in lacking) if x is not None]
    return max(found, key=lambda x: x.share, default=None)


class _Rows:
    """Rows of the joints that can be compared, means over `BIN` (K samples).

    motion (3, K, m): z, dz, ddz; scale (J,): rms of what the free numbers leave of the rows; y (K J,): that over its scale.
    """

    def __init__(self, joints: Sequence[int], motion: np.ndarray, y: np.ndarray, free: np.ndarray) -> None:
        self.joints, self.motion = list(joints), motion
        flat = free.reshape(-1, free.shape[2])
        U, s, _ = np.linalg.svd(flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300), full_matrices=False)
        U = U[:, s > NOTHING * s[0]]
        left = (y.reshape(-1) - U @ (U.T @ y.reshape(-1))).reshape(y.shape)
        self.scale = np.sqrt(np.mean(left**2, axis=0)) + 1e-300
        self._V, _ = np.linalg.qr((U.reshape(*y.shape, -1) / self.scale[:, None]).reshape(-1, U.shape[1]))
        self.y = self.left(y[:, :, None])[:, 0]

    def left(self, x: np.ndarray) -> np.ndarray:
        """What the free numbers leave (K J, F) of columns (K, J, F), each row over its scale."""
        flat = (x / self.scale[:, None]).reshape(-1, x.shape[2])
        return np.asarray(flat - self._V @ (self._V.T @ flat))

    def torque(self, robot: Robot, motion: np.ndarray) -> np.ndarray:
        """Torque (K, J) of the file along a motion (3, K, m)."""
        return np.asarray(nominal_torque(robot, *motion)[:, self.joints])


def _rows(robot: Robot, r: RobotRecording, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> _Rows | None:
    """The rows of a log: by torque the numbers of all links are free, by command the gains of each servo and a payload, and
    at each joint armature, viscous and dry friction and an offset. None where too little can be compared."""
    by_torque, drives = any(r.has("torque", n) for n in r.joints), joint_drives(robot)
    size = max(1, round(BIN / r.dt))
    joints, own, torque = [], [], []

    def mean(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[: len(x) // size * size].reshape(len(x) // size, size, *x.shape[1:]).mean(axis=1))

    for j, name in enumerate(robot.joints):
        d = drives[j]
        if not r.has("torque" if by_torque else "command", name) or (not by_torque and (d is None or d.velocity)):
            continue
        at, columns = r.joints.index(name), [np.ones(len(z)), dz[:, j], np.sign(dz[:, j]), ddz[:, j]]
        if d is None or by_torque:
            assert r.torque is not None
            torque.append(robot.gear[j] * r.torque[: len(z), at])
        else:
            assert r.command is not None
            error = d.target(r.command[: len(z), at], r.dt, float(z[0, j])) - d.slots[SLOT["zero"]] - z[:, j]
            limit = d.slots[SLOT["limit"]]
            torque.append(np.clip(d.slots[SLOT["kp"]] * error - d.slots[SLOT["kv"]] * dz[:, j], -limit, limit))
            columns.append(error)
        joints.append(j)
        own.append(mean(np.column_stack(columns)))
    if not joints or len(z) < FEWEST * size:
        return None
    motion = np.array([mean(x) for x in (z, dz, ddz)])
    links = link_rows(robot, *motion)[:, joints]
    centre = robot.nominal[-1, 1:4] / robot.nominal[-1, 0]
    shared = links.reshape(*links.shape[:2], -1) if by_torque else (links[:, :, -1] @ point_mass(1.0, centre))[:, :, None]
    y = mean(np.column_stack(torque)) - nominal_torque(robot, *motion)[:, joints]
    return _Rows(joints, motion, y, _blocks(own, shared))


def _blocks(own: Sequence[np.ndarray], shared: np.ndarray) -> np.ndarray:
    """Columns (K, J, F): those of each joint in its own row alone, then those that all rows share."""
    out, at = np.zeros((*shared.shape[:2], sum(x.shape[1] for x in own) + shared.shape[2])), 0
    for row, columns in enumerate(own):
        out[:, row, at : at + columns.shape[1]] = columns
        at += columns.shape[1]
    out[:, :, at:] = shared
    return out


def _tried(robot: Robot, rows: _Rows, k: int) -> Absent | None:
    """What joint k would have done; None where its motion explains too little, or no more than other couplings do."""
    B = _splines(BIN * np.arange(rows.motion.shape[1]))
    size, reach = B.shape[2], _reach(robot, k)
    ridge = np.eye(size) / reach**2  # a motion of about its reach is as likely as an error of the scale in every row
    c, held = np.zeros(size), rows.torque(robot, rows.motion)

    def moved(c: np.ndarray) -> np.ndarray:
        out = rows.motion.copy()
        out[:, :, k] += B @ c
        return out

    def left(c: np.ndarray) -> np.ndarray:
        return np.asarray(rows.y - rows.left((rows.torque(robot, moved(c)) - held)[:, :, None])[:, 0])

    for _ in range(ROUNDS):
        A = _columns(rows, _derivatives(robot, rows, moved(c), k), B)
        c = c + np.linalg.solve(A.T @ A + ridge, A.T @ left(c) - ridge @ c)
    share = 1.0 - float(np.sum(left(c) ** 2) / np.sum(rows.y**2))
    if share < MOST or _by_chance(rows, _derivatives(robot, rows, rows.motion, k), B, ridge, share):
        return None
    felt = np.sqrt(np.mean((rows.torque(robot, moved(c)) - held) ** 2, axis=0)) / rows.scale
    shown = tuple(robot.joints[j] for j, f in zip(rows.joints, felt, strict=True) if f > SHOWN * felt.max())
    return Absent(robot.joints[k], share, moved(c)[0, :, k], shown)


def _reach(robot: Robot, k: int) -> float:
    """Half of a joint's range; half a turn or half a metre where it has none [rad | m]."""
    low, high = robot.ranges[robot.leading(k)]
    free = math.pi if robot.motions[k] is Motion.HINGE else 0.5
    return 0.5 * float(high - low) if math.isfinite(high - low) else free


def _derivatives(robot: Robot, rows: _Rows, motion: np.ndarray, k: int) -> np.ndarray:
    """Derivatives (3, K, J) of the rows' torques by position, velocity and acceleration of joint k, by central differences."""
    out = []
    for i in range(3):
        ends = []
        for side in (-1.0, 1.0):
            other = motion.copy()
            other[i, :, k] += side * STEP
            ends.append(rows.torque(robot, other))
        out.append((ends[1] - ends[0]) / (2 * STEP))
    return np.array(out)


def _columns(rows: _Rows, D: np.ndarray, B: np.ndarray) -> np.ndarray:
    """What the free numbers leave (K J, b) of the rows' changes with each coefficient of the motion."""
    return rows.left(np.einsum("pkj,pkb->kjb", D, B))


def _by_chance(rows: _Rows, D: np.ndarray, B: np.ndarray, ridge: np.ndarray, share: float) -> bool:
    """Whether any of `DRAWS` couplings that are no joint's explains a share as large: at other times, rows exchanged and turned
    over."""
    rng, count = np.random.default_rng(0), D.shape[1]
    for _ in range(DRAWS):
        other = np.roll(D, int(rng.integers(count // 10, count - count // 10)), axis=1)
        other = other[:, :, rng.permutation(D.shape[2])] * rng.choice([-1.0, 1.0], D.shape[2])
        A = _columns(rows, other, B)
        c = np.linalg.solve(A.T @ A + ridge, A.T @ rows.y)
        if 1.0 - float(np.sum((rows.y - A @ c) ** 2) / np.sum(rows.y**2)) >= share:
            return True
    return False


def _splines(time: np.ndarray) -> np.ndarray:
    """Cubic B-splines and their first two derivatives (3, K, b) on a grid of `KNOT`."""
    from scipy.interpolate import BSpline

    inner = np.linspace(time[0], time[-1], max(2, round((time[-1] - time[0]) / KNOT) + 1))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    basis = BSpline(knots, np.eye(len(knots) - 4), 3)
    return np.array([basis(time), basis.derivative(1)(time), basis.derivative(2)(time)])
