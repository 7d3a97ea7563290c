"""Contact in a recording of a robot, in words: where it is, and which joints are not compared there."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mjsim.robot.model import Robot
from mjsim.robot.touching import Touching

__all__ = ["contact_notes", "stretches"]

NAMED = 2  # pairs and stretches that a note names


def stretches(at: np.ndarray, dt: float) -> list[tuple[float, float]]:
    """Start and end [s] of each run of samples (N,) bool, the longest first."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(int), [0]]))).reshape(-1, 2)
    return sorted(((float(a * dt), float(b * dt)) for a, b in edges), key=lambda x: x[0] - x[1])


def contact_notes(robot: Robot, found: Iterable[tuple[str, Touching, float]]) -> tuple[str, ...]:
    """A sentence for each recording with contact. found: source, contact and sample time [s] of each recording."""
    out = []
    for source, t, dt in found:
        if t.pairs:
            longest = sorted(t.pairs, key=lambda p: -int(p[2].sum()))
            named = "; ".join(f"{a} and {b} {_when(at, dt)}" for a, b, at in longest[:NAMED])
            more = f"; and {len(longest) - NAMED} more pairs" if len(longest) > NAMED else ""
            joints = [n for n, cut in zip(robot.joints, np.asarray(t.rows.any(axis=0)), strict=True) if cut]
            seconds = float(t.rows.any(axis=1).sum()) * dt
            out.append(
                f"Contact in {source}, by MuJoCo at the recorded positions: {named}{more}. {', '.join(joints)} "
                f"{'are' if len(joints) > 1 else 'is'} not compared in these {seconds:.3g} s. Exclude the pair in the model "
                "(<exclude>) where the robot does not touch."
            )
        out += [
            f"In {source} the geoms of {a} and {b} overlap at every sample: taken for the model's shape, no sample is left out. "
            "MuJoCo's own runs hold the force between them; exclude the pair in the model (<exclude>) where there is none."
            for a, b in t.always
        ]
    return tuple(out)


def _when(at: np.ndarray, dt: float) -> str:
    runs = stretches(at, dt)
    shown = ", ".join(f"{a:.3g} to {b:.3g} s" for a, b in runs[:NAMED])
    return shown + (f" and {len(runs) - NAMED} more stretches" if len(runs) > NAMED else "")
