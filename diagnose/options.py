"""Options of a diagnosis."""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Options of a diagnosis.

    judge: "motion", "force" or None (what the binding says, else by the channels); effects: identifiers to consider, all when
    empty; jobs: threads; seconds: budget of time, at whose end the
    search ends; effort: of simulations, times `RUNS`; depth: most effects. structure_share,
    structure_p: least part of the held-out squared error that must be predictable, and its p-value, for structure to remain;
    missed: least mean square of missed motion over that of the noise; left: least part of the mismatch that must be left where
    the noise is not known, closed: of the rms error above the noise, the part that must be closed where it is
    (docs/decisions/evidence.md). by_recording: fit friction to each recording by itself as well.
    """

    judge: str | None = None
    effects: tuple[str, ...] = ()
    jobs: int = 2
    seed: int = 0
    seconds: float = math.inf
    effort: float = 1.0
    depth: int = 3
    structure_share: float = 0.05
    structure_p: float = 1e-4
    missed: float = 0.05
    left: float = 0.01
    closed: float = 0.97
    by_recording: bool = False

    def since(self, began: float) -> Options:
        """These options with the rest of the budget of time at this moment; ``began``: its start (monotonic, [s])."""
        return dataclasses.replace(self, seconds=max(0.0, self.seconds - (time.monotonic() - began)))
