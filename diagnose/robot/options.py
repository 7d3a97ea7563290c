"""Options of a diagnosis of a robot."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

__all__ = ["RobotOptions"]


@dataclass(frozen=True)
class RobotOptions:
    """Options of a diagnosis of a robot.

    joints: names of the joints to diagnose, all that move when empty; effects: identifiers to consider, all when empty;
    cutoff_hz:
    of the low-pass on both sides, from the encoder's noise when None; most: largest number of effects; p_enter: level of the
    one-sided held-out test times the number of (joint, effect) hypotheses; material: least relative gain of the held-out squared
    error of a joint, 1 % of its rms error; remains: part of a joint's held-out squared error that a black-box model may
    predict: above it
    structure remains (where none does, a black-box model predicts less than nothing of samples that it was not fitted to);
    seed: kept for
    the record; until: when the search ends, by the monotonic clock [s].
    """

    joints: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    cutoff_hz: float | None = None
    most: int = 24
    p_enter: float = 0.01
    material: float = 0.02
    remains: float = 0.05
    seed: int = 0
    until: float = math.inf

    @property
    def late(self) -> bool:
        """Whether the budget of time is used up."""
        return time.monotonic() > self.until
