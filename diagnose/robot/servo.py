"""Servo stiffness and friction of each joint from command and position alone, where gravity gives the scale.

    kp (command - q) - kv q' = T(q, q', q'') + I q'' + F sign(q')

T is the torque that the links need by the masses of the file. Divided by kp this is linear,

    command - q = T / kp + (kv / kp) q' + (I / kp) q'' + (F / kp) sign(q'),

and T tells the scale: without gravity, gains, friction and inertia share one. Command and position are read by the same
encoder, so that there is no offset between them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.result import Estimate
from diagnose.robot.motion import RobotMotion, prepare
from mjsim.errors import InputError
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.rows import link_rows

__all__ = ["ServoEstimate", "servo_by_gravity"]

FEWEST = 100  # samples in motion, of a joint that is told of
BLOCK = 2.0  # [s] that are one independent block: several times what a servo remembers


@dataclass(frozen=True)
class ServoEstimate:
    """One joint: scaled values over kp, and kp with what follows from it, None where gravity does not give the scale.

    friction_angle: F / kp [rad | m]; time: kv / kp [s]; kp [N m/rad | N/m]; friction: F [N m | N]; share: of the mean
    square of command - position that is explained.
    """

    joint: str
    friction_angle: Estimate
    time: Estimate
    kp: Estimate | None
    friction: Estimate | None
    share: float


def servo_by_gravity(robot: Robot, recordings: Sequence[RobotRecording], cutoff: float) -> tuple[ServoEstimate, ...]:
    """Estimates of every joint that has a command and moves, from all recordings together, below a frequency [Hz].

    The command is taken for held over its sample. Intervals come from the spread over blocks of `BLOCK` (cluster-robust). Raises
    InputError where no joint has a command.
    """
    names = [n for n in robot.joints if recordings[0].has("command", n)]
    if not names:
        raise InputError(
            recordings[0].source, "no joint has a command", f"columns such as {robot.joints[0]}.command_rad", "add them"
        )
    motions = [_lagging(robot, r, names, cutoff) for r in recordings]
    links = [link_rows(robot, m.z, m.dz, m.ddz) for m in motions]
    moving = [n for n in names if sum(int(m.counts[:, robot.joints.index(n)].sum()) for m in motions) >= FEWEST]
    return tuple(_estimate(robot, motions, links, robot.joints.index(n)) for n in moving)


def _lagging(robot: Robot, r: RobotRecording, names: Sequence[str], cutoff: float) -> RobotMotion:
    """The recording behind the filter, command - position in the place of the torque; the command alone is held."""
    assert r.command is not None
    held = np.vstack([r.command[:1], 0.5 * (r.command[1:] + r.command[:-1])])
    gear = np.array([robot.gear[robot.joints.index(n)] for n in r.joints])
    return prepare(robot, dataclasses.replace(r, torque=(held - r.angle) / gear, hold="linear"), names, cutoff)


def _estimate(robot: Robot, motions: Sequence[RobotMotion], links: Sequence[np.ndarray], j: int) -> ServoEstimate:
    columns, targets, blocks, start = [], [], [], 0
    for m, Y in zip(motions, links, strict=True):
        torque = np.einsum("nlk,lk->n", Y[:, j], robot.nominal)
        C = np.column_stack(
            [m.low_passed(np.column_stack([torque, m.dz[:, j], m.ddz[:, j]])), m.low_passed(np.sign(m.dz[:, j]), 2)]
        )
        C = m.thinned(C)
        keep = m.counts[:, j]
        columns.append(C[keep])
        targets.append(m.thinned(m.torque[:, j])[keep])
        blocks.append(start + (np.flatnonzero(keep) * m.dt * m.every / BLOCK).astype(int))
        start = int(blocks[-1][-1]) + 1 if len(blocks[-1]) else start
    C, y, block = np.concatenate(columns), np.concatenate(targets), np.concatenate(blocks)
    scale = np.sqrt(np.mean(C**2, axis=0)) + 1e-300
    B = C / scale
    H = B.T @ B + 1e-12 * len(B) * np.eye(B.shape[1])
    x = np.linalg.solve(H, B.T @ y)
    e = y - B @ x
    scores = np.array([B[block == b].T @ e[block == b] for b in np.unique(block)])
    few = len(scores) / max(len(scores) - B.shape[1], 1)
    inverse = np.linalg.inv(H)
    V = few * (inverse @ (scores.T @ scores) @ inverse) / np.outer(scale, scale)
    c = x / scale
    share = 1.0 - float(np.mean(e**2) / (np.mean(y**2) + 1e-300))
    unit, angle = ("N m", "rad") if robot.motions[j].value == "hinge" else ("N", "m")
    scaled = _estimated(c[3], V[3, 3], angle), _estimated(c[1], V[1, 1], "s")
    if c[0] <= 1.96 * math.sqrt(V[0, 0]):  # the load does not tell the scale
        return ServoEstimate(robot.joints[j], *scaled, None, None, share)
    kp = 1.0 / c[0]
    g = np.array([-c[3] * kp**2, kp])  # gradient of F = c3 / c0 by (c0, c3)
    friction = float(g @ V[np.ix_([0, 3], [0, 3])] @ g)
    return ServoEstimate(
        robot.joints[j], *scaled, _estimated(kp, V[0, 0] * kp**4, f"{unit}/{angle}"), _estimated(c[3] * kp, friction, unit), share
    )


def _estimated(value: float, variance: float, unit: str) -> Estimate:
    half = 1.96 * math.sqrt(max(variance, 0.0))
    return Estimate(float(value), (float(value) - half, float(value) + half), unit)
