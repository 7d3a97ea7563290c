"""Stretches of a log that the corrected model of a servo joint does not follow: in words, file by file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from diagnose.robot.servos.fit import BLOCK, block_scale, block_squares
from diagnose.robot.servos.motion import JointProblem

__all__ = ["UNFOLLOWED", "unfollowed", "unfollowed_note"]

UNFOLLOWED = 25.0  # times the scale: mean square error of a block whose samples weigh 1/26 of those without error
NAMED = 3  # stretches that a note names, the longest first


def unfollowed(problem: JointProblem, error: np.ndarray) -> list[tuple[str, float, float]]:
    """Stretches (source, start [s], end [s]) of errors (N,) beyond `UNFOLLOWED`, those of adjacent blocks joined."""
    counts = problem.fitted | problem.held
    squares, number = block_squares(problem, error, counts)
    bad = (squares > UNFOLLOWED * block_scale(problem, error)) & (number > 0)
    block = problem.blocks(BLOCK)
    out = []
    for k, (source, _) in enumerate(problem.sources):
        part = problem.part(k)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], bad[block[part]].astype(int), [0]])))
        out += [(source, float(a * problem.dt), float(b * problem.dt)) for a, b in edges.reshape(-1, 2)]
    return out


def unfollowed_note(problem: JointProblem, error: np.ndarray) -> str:
    """The stretches in one sentence, empty where there is none."""
    found = sorted(unfollowed(problem, error), key=lambda x: x[1] - x[2])
    if not found:
        return ""
    named = ", ".join(f"{Path(source).name} {a:.0f} to {b:.0f} s" for source, a, b in found[:NAMED])
    more = f" and {len(found) - NAMED} more" if len(found) > NAMED else ""
    total = sum(b - a for _, a, b in found)
    return (
        f"{problem.name}: the model does not follow {total:.0f} s of the log ({named}{more}), where its error is over "
        f"{np.sqrt(UNFOLLOWED):.0f} times that of the median stretch. They hardly count in the fit. Look there for contact, a "
        "stop or a limit of the servo."
    )
