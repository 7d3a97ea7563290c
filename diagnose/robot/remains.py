"""What is still predictable of a joint's torque: a black-box regression of the residual, judged on held-out samples.

The noise of a torque is not known beforehand. The yardstick is a dictionary of functions of the joint's own position, velocity,
acceleration and load and of the other joints' velocities, fitted to the residual by ridge regression: what it predicts of
the held-out residual is
structure that the model does not have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnose.robot.black_box import predictable, ridge
from diagnose.robot.laws import Row
from diagnose.robot.problem import Problem
from diagnose.robot.solve import Solution, held_out

__all__ = ["black_box"]


def _dictionary(row: Row) -> np.ndarray:
    """Functions (N, k) of the motion of a joint, and of the velocities of the others; each of unit rms."""
    v = row.v / (np.sqrt(np.mean(row.v**2)) + 1e-300)
    q = (row.q - np.mean(row.q)) / (np.std(row.q) + 1e-300)
    load = row.load / (np.sqrt(np.mean(row.load**2)) + 1e-300)
    a = np.gradient(v)
    s = np.tanh(v / 0.05)
    columns = [np.ones_like(v), s, v, np.abs(v), v * np.abs(v), v**3,
               s * np.exp(-((v / 0.2) ** 2)), q, q**2, q**3, s * q, s * q**2,
               load, s * np.abs(load), load * np.abs(load), a, a * np.abs(a), a * q, v * q, s * row.t]  # fmt: skip
    for velocity, _ in row.others.values():
        w = velocity / (np.sqrt(np.mean(velocity**2)) + 1e-300)
        columns += [w, np.tanh(w / 0.05), w * v]
    return np.column_stack(columns)


def black_box(
    problem: Problem, s: Solution, weights: Mapping[int, float], rows: Sequence[dict[int, Row]], joint: int
) -> tuple[float, float]:
    """(share of the held-out squared residual that the dictionary predicts, its one-sided p-value)."""
    fitted, held = [], []
    for motion, row in zip(problem.motions, rows, strict=True):
        D = motion.thinned(motion.low_passed(_dictionary(row[joint]), 2))
        fitted.append(D[motion.counts[:, joint] & ~motion.held])
        held.append(D[motion.counts[:, joint] & motion.held])
    D, E = np.concatenate(fitted), np.concatenate(held)
    if len(E) < 10:
        return 0.0, 1.0
    left = (s.held[joint] - E @ ridge(D, s.fitted[joint])) * weights[joint]
    return predictable(held_out(problem, s, weights, joint), left)
