"""What changes of the links' inertial parameters add to what each joint carries along a motion.

All series of `mjsim.robot.along` are linear in the inertial parameters. A change of them adds its own inertia M_jj, torque b_j,
derivative of b_j by q_j, whole torque and weight. The derivative of b_j by q_j' is left out: it acts on the deviation of the
velocity from the recorded one alone.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from mjsim.robot.model import Robot
from mjsim.robot.rows import link_rows

__all__ = ["SERIES", "compensation", "shares"]

SERIES = ("inertia", "bias", "by_position", "torque", "weight")
EPS = 1e-5  # step of the differences [rad | m]: the cube root of double precision, for central ones
CHUNK = 4000  # samples at once


def shares(robot: Robot, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Series (N, m, C, 5), single precision, by joint, change and `SERIES` along a motion (N, m) of the independent joints.

    changes (C, L, 10): of the links' inertial parameters [kg, kg m, kg m^2].
    """
    parts = [_shares(robot, z[k : k + CHUNK], dz[k : k + CHUNK], ddz[k : k + CHUNK], changes) for k in range(0, len(z), CHUNK)]
    return np.concatenate(parts)


def compensation(robot: Robot, z: np.ndarray) -> np.ndarray:
    """Series (N, m, 5), single precision, by joint and `SERIES` along positions (N, m), of drives that carry the whole weight."""
    model = copy.copy(robot.model)
    model.body_gravcomp[:] = 0.0
    bare = dataclasses.replace(robot, model=model)
    out = np.zeros((*z.shape, len(SERIES)), np.float32)
    weight = _weight(bare, z)
    out[..., 1] = out[..., 3] = out[..., 4] = -weight
    for j in range(z.shape[1]):
        unit = np.zeros_like(z)
        unit[:, j] = EPS
        out[:, j, 2] = (_weight(bare, z - unit) - _weight(bare, z + unit))[:, j] / (2 * EPS)
    return out


def _weight(robot: Robot, z: np.ndarray) -> np.ndarray:
    """Torque of the links' weight (N, m) at positions (N, m)."""
    parts = [z[k : k + CHUNK] for k in range(0, len(z), CHUNK)]
    rows = [link_rows(robot, x, np.zeros_like(x), np.zeros_like(x)) for x in parts]
    return np.concatenate([np.einsum("nmlk,lk->nm", r, robot.nominal) for r in rows])


def _shares(robot: Robot, z: np.ndarray, dz: np.ndarray, ddz: np.ndarray, changes: np.ndarray) -> np.ndarray:
    def torque(z: np.ndarray, dz: np.ndarray, ddz: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("nmlk,clk->nmc", link_rows(robot, z, dz, ddz), changes, optimize=True))

    still = np.zeros_like(z)
    weight, whole = torque(z, still, still), torque(z, dz, ddz)
    out = np.empty((*whole.shape, len(SERIES)), np.float32)
    for j in range(z.shape[1]):
        unit = still.copy()
        unit[:, j] = 1.0
        high, low = (torque(z + s * EPS * unit, dz, ddz)[:, j] for s in (1.0, -1.0))
        out[:, j, :, 0] = (torque(z, still, unit) - weight)[:, j]
        out[:, j, :, 2] = (high - low) / (2 * EPS)
    out[..., 1] = whole - out[..., 0] * ddz[:, :, None]
    out[..., 3], out[..., 4] = whole, weight
    return out
