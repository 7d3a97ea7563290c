"""The hold of the input that the recordings show, in place of one that nobody stated."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from diagnose.check.faults.hold import nearest_hold, shift_of
from diagnose.check.machine import Machine
from diagnose.check.thresholds import HOLD_TOLERANCE, Z95, Z_TEST
from diagnose.check.types import LogCheck
from mjsim.recording import Recording

__all__ = ["shows_hold", "told_as_taken", "with_found_hold"]

_FAULT = "hold"


def with_found_hold(
    check: LogCheck, machine: Machine, recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]] | None:
    """The recordings with the hold that the check found, where none states it; else None.

    Found in one of them at least, and contradicted by none: one logger writes them all, and a short recording may not show its
    hold alone. An input that acts half a sample or a sample before it would if it were held: no drive is early, so that this is
    no physics.
    """
    every = (*recordings, *held_out)
    shifts = [p.value for p in check.problems if p.problem == _FAULT and p.value < 0.0]
    found = {nearest_hold(shift, "held") for shift in shifts}
    assumed = all(r.hold == "held" and not r.hold_stated for r in every)
    if not assumed or len(found) != 1:
        return None
    hold = found.pop()
    if any(_contradicts(check, machine, r, hold) for r in every):
        return None
    first, second = ([dataclasses.replace(r, hold=hold) for r in group] for group in (recordings, held_out))
    return first, second


def shows_hold(check: LogCheck) -> bool:
    """Whether the delay of a recording is known well enough to tell holds apart."""
    return any(
        Z_TEST * _error(own) <= HOLD_TOLERANCE * own["sample_time_s"] for own in check.measured.values() if "delay_s" in own
    )


def _error(own: Mapping[str, Any]) -> float:
    """Standard error of a measured delay [s]."""
    low, high = own["delay_s"]["ci95"]
    return float(high - low) / (2.0 * Z95)


def _contradicts(check: LogCheck, machine: Machine, recording: Recording, hold: str) -> bool:
    """Whether the delay of a recording is not that of a hold, to `Z_TEST` standard errors."""
    own = check.measured.get(recording.source, {})
    if any(p.problem == _FAULT and p.recording == recording.source for p in check.problems) or "delay_s" not in own:
        return False
    delay, dt = own["delay_s"], own["sample_time_s"]
    return bool(abs(delay["value"] - machine.input_lag() - shift_of(hold, "held") * dt) > Z_TEST * _error(own))


def told_as_taken(check: LogCheck, taken: LogCheck) -> LogCheck:
    """The check of the recordings with the hold that was taken, with what was found as a limit."""
    found = [
        dataclasses.replace(p, advice=f"the diagnosis takes it so; {p.advice} to confirm it")
        for p in check.problems
        if p.problem == _FAULT
    ]
    return dataclasses.replace(taken, problems=(*found, *(p for p in taken.problems if p.problem != _FAULT)))
