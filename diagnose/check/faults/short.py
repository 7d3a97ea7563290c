"""A recording with fewer samples than a diagnosis takes."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from diagnose.thresholds import FEWEST, SHORTEST
from mjsim.recording import Recording

__all__ = ["count_of", "short", "too_short"]


@check("short", "short", question="Are there samples enough?")
def short(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Fewer measured samples than `diagnose.data.experiment.prepare` asks for."""
    return too_short(recording, context.together)


def count_of(recording: Recording) -> int:
    """Number of samples that were measured, also of a recording that is not on a grid yet."""
    missing = getattr(recording, "missing", None)
    return len(recording) - (0 if missing is None else int(np.sum(missing)))


def too_short(recording: Recording, together: int = 0) -> list[Problem]:
    """The one problem of a recording with fewer measured samples than a diagnosis takes; [] for any other.

    ``together``: measured samples of all recordings that are checked at once.
    """
    count = count_of(recording)
    if count >= (SHORTEST if together >= FEWEST else FEWEST):
        return []
    return [
        Problem(
            "time", "short", count, "samples",
            f"{count} samples were measured, {recording.duration:.3g} s; a diagnosis takes at least {FEWEST}, "
            f"or {SHORTEST} of each of several recordings.",
            "record longer, at a higher rate, or several times", Severity.FIX,
        )
    ]  # fmt: skip
