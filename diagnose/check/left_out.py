"""Channels that may be left out in place of a fault that they alone have: the diagnosis goes on by the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from diagnose.check.types import LogCheck, LogVerdict, Severity
from mjsim.recording import Recording

__all__ = ["told_as_left_out", "without_late_velocity"]

_FAULT = "channel_skew"  # of the velocity against the angle: a filter of its own, or another clock


def without_late_velocity(
    check: LogCheck, recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]] | None:
    """The recordings without a velocity that is late against the angle, where that is all that has to be fixed; else None.

    The angle takes its place.
    """
    only = check.verdict is LogVerdict.FIX and all(p.problem == _FAULT for p in check.to_fix())
    if not only or any(r.angle is None for r in (*recordings, *held_out)):
        return None
    first, second = ([dataclasses.replace(r, velocity=None) for r in group] for group in (recordings, held_out))
    return first, second


def told_as_left_out(check: LogCheck, without: LogCheck) -> LogCheck:
    """The check of the remaining channels, with the fault of the unused one as a limit."""
    gone = [
        dataclasses.replace(p, severity=Severity.LIMITS, advice=f"the velocity is left out and the angle used; {p.advice}")
        for p in check.to_fix()
    ]
    return dataclasses.replace(without, problems=(*gone, *without.problems))
