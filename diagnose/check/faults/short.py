"""A recording with fewer samples than a diagnosis takes."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from diagnose.thresholds import FEWEST
from mjsim.recording import Recording

__all__ = ["short", "too_short"]


@check("short", "short", question="Are there samples enough?")
def short(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Fewer measured samples than `diagnose.data.experiment.prepare` asks for."""
    return too_short(recording)


def too_short(recording: Recording) -> list[Problem]:
    """The one problem of a recording with fewer measured samples than a diagnosis takes; [] for any other."""
    missing = getattr(recording, "missing", None)
    count = len(recording) - (0 if missing is None else int(np.sum(missing)))
    if count >= FEWEST:
        return []
    return [
        Problem(
            "time", "short", count, "samples",
            f"{count} samples were measured, {recording.duration:.3g} s; a diagnosis takes at least {FEWEST}.",
            "record longer, or at a higher rate", Severity.FIX,
        )
    ]  # fmt: skip
