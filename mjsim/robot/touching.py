"""Contact along a recorded motion: which samples of which joints hold a contact force, by MuJoCo at the recorded positions."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.robot.model import Robot
from mjsim.robot.transmission import name_of

__all__ = ["Touching", "touching"]

RATE = 100.0  # [Hz] at which contact is looked for: what lasts less is missed, and is no longer than the filters of the motion


@dataclass(frozen=True, eq=False)
class Touching:
    """Contact along a motion of N samples.

    rows (N, m): samples at which a contact force acts on the row of a joint; pairs: of bodies that touch, with the samples
    (N,) at which they do; always: pairs whose geoms overlap at every sample, as modelled, and that are left out of ``rows``.
    """

    rows: np.ndarray
    pairs: tuple[tuple[str, str, np.ndarray], ...] = ()
    always: tuple[tuple[str, str], ...] = ()

    def widened(self, before: int, after: int) -> np.ndarray:
        """``rows`` with so many samples before and after each contact (N, m)."""
        edges = np.zeros((len(self.rows) + 1, self.rows.shape[1]), int)
        at, joint = np.nonzero(self.rows)
        np.add.at(edges, (np.maximum(at - before, 0), joint), 1)
        np.add.at(edges, (np.minimum(at + after + 1, len(self.rows)), joint), -1)
        return np.asarray(np.cumsum(edges, axis=0)[:-1] > 0)


def touching(robot: Robot, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray, dt: float) -> Touching:
    """Contact along a motion (N, m) [rad | m, per second, per second squared] with samples ``dt`` [s] apart.

    A contact counts where MuJoCo's inverse dynamics have a force in it. Its torque is about the joints on the path between the
    two bodies: about others it is an inner force.
    """
    rows = np.zeros(z.shape, bool)
    model = copy.copy(robot.model)
    if not _may_touch(model):
        return Touching(rows)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data, every = mujoco.MjData(model), max(1, math.floor(1.0 / (RATE * dt) + 1e-9))
    at = np.arange(0, len(z), every)
    q, v, a = z[at] @ robot.tie.T + robot.rest, dz[at] @ robot.tie.T, ddz[at] @ robot.tie.T
    found: dict[tuple[int, int], np.ndarray] = {}
    for k in range(len(at)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        for pair in _pressed(model, data):
            found.setdefault(pair, np.zeros(len(at), bool))[k] = True
    always = tuple(p for p, seen in found.items() if seen.all())
    for pair, seen in found.items():
        if pair not in always:
            rows |= np.outer(_spread(seen, every, len(z)), _felt(robot, pair))
    pairs = tuple((*_named(model, p), _spread(seen, every, len(z))) for p, seen in found.items() if p not in always)
    return Touching(rows, pairs, tuple(_named(model, p) for p in always))


def _may_touch(model: mujoco.MjModel) -> bool:
    """Whether the file has geoms that collide: of bodies that move, or a pair."""
    moves = model.body_weldid[model.geom_bodyid] != 0
    return bool(np.any(moves & ((model.geom_contype > 0) | (model.geom_conaffinity > 0))) or model.npair)


def _pressed(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[int, int]]:
    """Pairs of bodies with a force in a contact between them."""
    out, force = set(), np.zeros(6)
    for c in range(data.ncon):
        mujoco.mj_contactForce(model, data, c, force)
        if force[0] > 0.0 and data.contact.geom[c].min() >= 0:
            one, two = (int(model.geom_bodyid[g]) for g in data.contact.geom[c])
            out.add((min(one, two), max(one, two)))
    return out


def _felt(robot: Robot, pair: Sequence[int]) -> np.ndarray:
    """Independent joints (m,) about which a force between two bodies has a torque."""
    model, paths = robot.model, []
    for body in pair:
        path, b = set(), body
        while b > 0:
            path.add(b)
            b = int(model.body_parentid[b])
        paths.append(path)
    between = np.isin(model.jnt_bodyid, list(paths[0] ^ paths[1]))
    return np.asarray(np.any(robot.tie[between] != 0.0, axis=0))


def _spread(seen: np.ndarray, every: int, count: int) -> np.ndarray:
    """Samples (count,) around those that were looked at."""
    return np.repeat(seen, every)[:count]


def _named(model: mujoco.MjModel, pair: Sequence[int]) -> tuple[str, str]:
    one, two = (name_of(model, mujoco.mjtObj.mjOBJ_BODY, b) for b in pair)
    return one, two
