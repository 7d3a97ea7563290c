"""What is still predictable of a servo joint's position error: a black-box regression, judged on held-out samples.

The dictionary holds functions of the command and of the simulated motion at several lags: nothing of the measured position of
the joint
itself, so that what it predicts is structure that the model lacks.
"""

from __future__ import annotations

import numpy as np

from diagnose.robot.black_box import predictable, ridge
from diagnose.robot.servos.fit import Fit
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.state import held_out

__all__ = ["black_box", "tells"]

FEWEST = 30  # held-out samples that a dictionary is judged on
BLOCKS = 3  # independent ones among them: of fewer, `compare` knows no chance

LAGS = (0.0, 0.1, 0.25, 0.6)  # [s]


def _dictionary(problem: JointProblem, fit: Fit) -> np.ndarray:
    """Columns (N, k) of unit size."""
    q, v = problem.run(fit.slots)
    unit = float(np.std(q)) + 1e-300
    speed = float(np.sqrt(np.mean(v**2))) + 1e-300
    load = problem.series[:, 4] / (float(np.sqrt(np.mean(problem.series[:, 4] ** 2))) + 1e-300)
    error = problem.first - (v if problem.drive.velocity else q)
    error = error / (float(np.sqrt(np.mean(error**2))) + 1e-300)
    x, w = (q - np.mean(q)) / unit, v / speed
    s = np.tanh(w / 0.05)
    base = [x, x**2, x**3, w, w * np.abs(w), s, s * np.abs(load), load, error, error * np.abs(error), np.tanh(error), s * x]
    columns = [np.ones(len(q))]
    for lag in LAGS:
        shift = round(lag / problem.dt)
        for c in base:
            moved = c.copy()
            for k in range(len(problem.sources)):
                part = problem.part(k)
                own = c[part]
                moved[part] = np.concatenate([np.full(min(shift, len(own)), own[0]), own[: max(len(own) - shift, 0)]])
            columns.append(moved)
    return np.column_stack(columns)


def tells(problem: JointProblem, error: np.ndarray, weights: np.ndarray) -> bool:
    """Whether the held-out samples of an error (N,), weighted (N,), are enough for `black_box` to find structure in it."""
    return int(problem.held.sum()) >= FEWEST and int(np.sum(held_out(problem, error, weights).n > 0)) >= BLOCKS


def black_box(problem: JointProblem, fit: Fit) -> tuple[float, float]:
    """(share of the held-out squared error that the dictionary predicts, its one-sided p-value)."""
    if problem.held.sum() < FEWEST:
        return 0.0, 1.0
    D = _dictionary(problem, fit)
    each = fit.weights
    c = ridge(D[problem.fitted] * each[problem.fitted, None], (each * fit.error)[problem.fitted])
    left = ((fit.error - D @ c) * each)[problem.held]
    return predictable(held_out(problem, fit.error, fit.weights), left)
