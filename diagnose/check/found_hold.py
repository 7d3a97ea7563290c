"""The hold of the input that the recordings show, in place of one that nobody stated."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from diagnose.check.faults.hold import nearest_hold
from diagnose.check.types import LogCheck
from mjsim.recording import Recording

__all__ = ["told_as_taken", "with_found_hold"]

_FAULT = "hold"


def with_found_hold(
    check: LogCheck, recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]] | None:
    """The recordings with the hold that the check found in every one of them, where none states it; else None.

    An input that acts half a sample or a sample before it would if it were held: no drive is early, so that this is no physics.
    """
    every = (*recordings, *held_out)
    shifts = [p.value for p in check.problems if p.problem == _FAULT and p.value < 0.0]
    found = {nearest_hold(shift, "held") for shift in shifts}
    assumed = all(r.hold == "held" and not r.hold_stated for r in every)
    if not assumed or len(shifts) != len(every) or len(found) != 1:
        return None
    hold = found.pop()
    first, second = ([dataclasses.replace(r, hold=hold) for r in group] for group in (recordings, held_out))
    return first, second


def told_as_taken(check: LogCheck, taken: LogCheck) -> LogCheck:
    """The check of the recordings with the hold that was taken, with what was found as a limit."""
    found = [
        dataclasses.replace(p, advice=f"the diagnosis takes it so; {p.advice} to confirm it")
        for p in check.problems
        if p.problem == _FAULT
    ]
    return dataclasses.replace(taken, problems=(*found, *(p for p in taken.problems if p.problem != _FAULT)))
