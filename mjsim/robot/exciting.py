"""Exciting trajectories of a robot: band-limited Fourier series within its limits, of a small condition number.

    q_j(t) = c_j + s_j sum over l = 1..H of (a_jl / w_l) sin(w_l t) - (b_jl / w_l) cos(w_l t),   w_l = 2 pi l f

with sum a_jl = 0 and sum b_jl w_l = 0, so that the motion starts at rest and without acceleration. Centre c_j and size s_j keep
each joint within a share of its range and below its speed. The coefficients are the best found for the condition number of the
regression that determines the robot's numbers. Source: J. Swevers et al., IEEE Trans. Robotics and Automation 13 (1997) 730.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.mjcf.drive_laws import law_of, range_of
from mjsim.quantity import Motion
from mjsim.robot.model import Robot
from mjsim.robot.rows import link_rows, nominal_torque
from mjsim.threads import one_thread

__all__ = ["Excitation", "Limits", "exciting"]

SCORED = 100  # samples of a period at which a candidate is scored
FINE = 10  # samples of the highest harmonic, between which its extremes may lie: they are missed by at most 5 %
TRIALS = 40  # random series, of which the best is refined
ROUNDS = 120  # changes of one joint's coefficients that are tried
SHRINK, TIMES = 0.7, 8  # factor on all sizes, and how often, where the robot touches something or lacks torque: at last 6 %
ZERO = 1e-9  # of the largest singular value: what rounding leaves of numbers that no motion shows


@dataclass(frozen=True)
class Limits:
    """Share of each joint's range that is used; largest speeds of hinges [rad/s] and slides [m/s]; reach of joints without a
    range to either side [rad, m]."""

    share: float = 0.8
    speed_rad_s: float = 2.0
    speed_m_s: float = 0.25
    reach_rad: float = math.pi / 2
    reach_m: float = 0.2


@dataclass(frozen=True, eq=False)
class Excitation:
    """A trajectory (N, m) of the independent joints [rad | m, per second, per second squared]; condition: of its regression;
    shrunk: factor on its sizes with which the robot touches nothing and its motors suffice."""

    z: np.ndarray
    dz: np.ndarray
    ddz: np.ndarray
    condition: float
    shrunk: float


@one_thread
def exciting(
    robot: Robot,
    rng: np.random.Generator,
    time: np.ndarray,
    base_hz: float,
    harmonics: int,
    limits: Limits,
    joints: Sequence[str] = (),
) -> Excitation:
    """The best trajectory found at times (N,) [s], of the joints that a motor drives, or of ``joints``; others rest.

    Raises InputError for a joint that is not there and where no trajectory is within the motors' torque and free of contact.
    """
    chosen = joints or [n for n, d in zip(robot.joints, robot.driven, strict=True) if d] or robot.joints
    moving = np.array([n in chosen for n in robot.joints])
    search = _Search(robot, rng, base_hz, harmonics, moving)
    for k in range(TIMES + 1):
        shrunk = SHRINK**k
        search.limit(limits, shrunk)
        best = search.run()
        if best is not None:
            z, dz, ddz = search.motion(best[1], time, search.sizes(best[1]))
            return Excitation(z, dz, ddz, best[0], shrunk)
    raise InputError(
        robot.source, search.why, "a pose about which the joints can move", "give a keyframe in such a pose, or name --joint"
    )


def _centres(robot: Robot) -> np.ndarray:
    """Middle (m,) of the motion: the first keyframe, else the middle of the range, else qpos0."""
    lead = np.array([robot.leading(j) for j in range(len(robot.joints))])
    if robot.model.nkey:
        return np.asarray(robot.model.key_qpos[0][lead])
    ranges = robot.ranges[lead]
    limited = np.isfinite(ranges).all(axis=1)
    middle = np.mean(np.where(limited[:, None], ranges, 0.0), axis=1)
    return np.asarray(np.where(limited, middle, robot.model.qpos0[lead]))


class _Search:
    """Candidates of coefficients (2, m, H) and their condition numbers."""

    def __init__(self, robot: Robot, rng: np.random.Generator, base_hz: float, harmonics: int, moving: np.ndarray) -> None:
        self.robot, self.rng, self.moving = robot, rng, moving
        self.w = 2 * math.pi * base_hz * np.arange(1, harmonics + 1)
        self.shape = (2, len(robot.joints), harmonics)
        self.centre = _centres(robot)
        self.scored = np.arange(SCORED) / (SCORED * base_hz)
        count = FINE * harmonics
        self.fine = np.arange(count) / (count * base_hz)
        self.data = mujoco.MjData(robot.model)
        self.torque = _torque_limits(robot)
        self.why = ""
        self.basis = self._basis()

    def limit(self, limits: Limits, shrunk: float) -> None:
        """Set the largest reach and speed (m,) of each joint."""
        robot = self.robot
        lead = [robot.leading(j) for j in range(len(robot.joints))]
        hinge = np.array([x is Motion.HINGE for x in robot.motions])
        low, high = robot.ranges[lead].T
        room = np.minimum(self.centre - low, high - self.centre)
        free = np.where(hinge, limits.reach_rad, limits.reach_m)
        self.reach = shrunk * np.where(np.isfinite(room), limits.share * np.maximum(room, 0.0), free)
        self.speed = shrunk * np.where(hinge, limits.speed_rad_s, limits.speed_m_s)

    def run(self) -> tuple[float, np.ndarray] | None:
        """Condition number and coefficients of the best allowed trajectory; None where none is allowed."""
        best: tuple[float, np.ndarray] | None = None
        for k in range(TRIALS + ROUNDS):
            if k < TRIALS or best is None:
                c = self._at_rest(self.rng.standard_normal(self.shape))
            else:
                c = best[1].copy()
                j = int(self.rng.choice(np.flatnonzero(self.moving)))
                c[:, j] += self.rng.uniform(0.1, 1.0) * self.rng.standard_normal((2, self.shape[2]))
                c = self._at_rest(c)
            z, dz, ddz = self.motion(c, self.scored, self.sizes(c))
            score = self._condition(z, dz, ddz)
            if (best is None or score < best[0]) and self._allowed(z, dz, ddz):
                best = score, c
            if best is None and k == TRIALS:
                return None
        return best

    def _at_rest(self, c: np.ndarray) -> np.ndarray:
        """The nearest coefficients with which the motion starts without speed and acceleration."""
        a, b = c
        a = a - a.mean(axis=1, keepdims=True)
        b = b - np.outer(b @ self.w, self.w) / (self.w @ self.w)
        return np.asarray(np.stack([a, b]) * self.moving[:, None])

    def sizes(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Size and middle (m,) of each joint's series, with which it keeps its reach and its speed."""
        q, v, _ = self._series(c, self.fine)
        half, middle = 0.5 * np.ptp(q, axis=0), 0.5 * (q.max(axis=0) + q.min(axis=0))
        fastest = np.max(np.abs(v), axis=0)
        room = self.reach / np.where(half > 0, half, np.inf), self.speed / np.where(fastest > 0, fastest, np.inf)
        return np.minimum(*room), middle

    def motion(self, c: np.ndarray, t: np.ndarray, sizes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, ...]:
        """Position, speed and acceleration (N, m) at times (N,)."""
        q, v, a = self._series(c, t)
        size, middle = sizes
        z: np.ndarray = self.centre + size * (q - middle)
        return z, size * v, size * a

    def _series(self, c: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, ...]:
        a, b = c
        s, k = np.sin(np.outer(t, self.w)), np.cos(np.outer(t, self.w))
        return s @ (a / self.w).T - k @ (b / self.w).T, k @ a.T + s @ b.T, k @ (b * self.w).T - s @ (a * self.w).T

    def _rows(self, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> np.ndarray:
        """Regressor (N m, P) of links, armatures, viscous and dry friction, each joint over the size of its torque."""
        n, m = z.shape
        links = link_rows(self.robot, z, dz, ddz).reshape(n, m, -1)
        own = np.concatenate([x[:, :, None] * np.eye(m) for x in (ddz, dz, np.sign(dz))], axis=2)
        rows = np.concatenate([links, own], axis=2) / self.weight[:, None]
        return np.asarray(rows[:, self.moving].reshape(-1, rows.shape[2]))

    def _basis(self) -> np.ndarray:
        """Directions (P, r) of the numbers that any motion of these joints shows, each column over its own size."""
        m, self.weight = len(self.robot.joints), np.ones(len(self.robot.joints))
        z, dz, ddz = (self.rng.standard_normal((SCORED, m)) * self.moving for _ in range(3))
        z = self.centre + z
        self.weight = np.sqrt(np.mean(nominal_torque(self.robot, z, dz, ddz) ** 2, axis=0)) + 1e-300
        rows = self._rows(z, dz, ddz)
        self.scale = np.linalg.norm(rows, axis=0)
        self.scale[self.scale <= ZERO * self.scale.max()] = np.inf
        _, s, V = np.linalg.svd(rows / self.scale, full_matrices=False)
        return np.asarray(V[s > ZERO * s[0]].T)

    def _condition(self, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> float:
        rows = (self._rows(z, dz, ddz) / self.scale) @ self.basis
        powers = np.linalg.eigvalsh(rows.T @ rows)  # squares of the singular values: exact enough up to a condition of 1e7
        return math.sqrt(powers[-1] / powers[0]) if powers[0] > 0 else math.inf

    def _allowed(self, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> bool:
        """Whether the motors suffice and nothing touches; else ``why`` says so."""
        robot, model, data = self.robot, self.robot.model, self.data
        needed = np.max(np.abs(nominal_torque(robot, z, dz, ddz)), axis=0)
        lacking = np.flatnonzero(needed > self.torque)
        if len(lacking):
            j = int(lacking[0])
            self.why = f"{robot.joints[j]} needs {needed[j]:.3g}, and its motor gives {self.torque[j]:.3g}"
            return False
        for q in z @ robot.tie.T + robot.rest:
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon:
                names = [_geom(model, int(g)) for g in data.contact.geom[0]]
                self.why = f"{names[0]} and {names[1]} touch in the middle of the joints' ranges"
                return False
        return True


def _geom(model: mujoco.MjModel, geom: int) -> str:
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or f"a geom of {model.body(model.geom_bodyid[geom]).name}"


def _torque_limits(robot: Robot) -> np.ndarray:
    """Largest torque (m,) of each joint's motor at the joint, infinite where the file has no limit."""
    model, out = robot.model, np.full(len(robot.joints), math.inf)
    for j, a in enumerate(robot.actuators):
        if a < 0:
            continue
        gear = abs(float(robot.gear[j]))
        if model.actuator_forcelimited[a]:
            out[j] = min(out[j], gear * float(np.min(np.abs(model.actuator_forcerange[a]))))
        law, span = law_of(model, a), range_of(model, a)
        if math.isfinite(span[0]) and not (law.of_length or law.of_speed):
            out[j] = min(out[j], gear * abs(law.gain) * min(map(abs, span)))
    return out
