"""A recording with fewer samples than a diagnosis takes."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from diagnose.data.experiment import measured_count
from diagnose.thresholds import FEWEST, SHORTEST
from mjsim.recording import Recording

__all__ = ["short", "too_short"]


@check("short", "short", question="Are there samples enough?")
def short(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Fewer measured samples than `diagnose.data.experiment.prepare` asks for."""
    return too_short(recording, context.together)


def too_short(recording: Recording, together: int = 0) -> list[Problem]:
    """The one problem of a recording with fewer measured samples than a diagnosis takes; [] for any other.

    ``together``: measured samples of all recordings that are checked at once.
    """
    count = measured_count(recording)
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
