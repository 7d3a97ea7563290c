"""The log of one servo joint before and after the search: its check, and how its command goes between samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from diagnose.check import LogCheck
from diagnose.fit.command_hold import hold_instead, is_assumed, shown_hold, taken_hold, with_hold
from diagnose.result import Diagnosis, Verdict
from diagnose.robot.check.axis import check_servo_axis
from diagnose.thresholds import UNEXPLAINED
from mjsim.axis import Axis
from mjsim.recording import Recording
from mjsim.robot.model import load_robot
from simgap.found import as_fitted, corrected_axis, physics_found

__all__ = ["checked_servo", "hold_beside", "with_taken"]


def checked_servo(
    model: Path, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], seconds: float
) -> tuple[LogCheck | None, Sequence[Recording], Sequence[Recording]]:
    """The check of a servo's log, and the recordings with the hold that they show where none is stated.

    No check of a servo that is switched off. ``seconds``: the most that the question of the hold takes.
    """
    every = [*recordings, *held_out]
    if not all(r.driven for r in every):
        return None, recordings, held_out
    log = check_servo_axis(nominal.chain, load_robot(model), every)
    hold = "held" if log.to_fix() or not is_assumed(every) else shown_hold(nominal, recordings, held_out, seconds)
    if hold == "held":
        return log, recordings, held_out
    return with_taken(log, hold, recordings), with_hold(recordings, hold), with_hold(held_out, hold)


def hold_beside(
    result: Diagnosis, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], seconds: float
) -> str:
    """The hold of a command that shows once effects are there that leave more than noise, or explains as much as one of them.

    "held" where none does.
    """
    assumed = nominal.chain.servo is not None and is_assumed([*recordings, *held_out])
    if not result.findings or not assumed or not seconds > 0:
        return "held"
    more = result.noise_floor > 0 and result.fit["corrected"].rms ** 2 > UNEXPLAINED * result.noise_floor**2
    found = corrected_axis(nominal, result)
    if result.verdict is Verdict.UNEXPLAINED or more:
        shown = shown_hold(found, recordings, held_out, seconds)
        if shown != "held":
            return shown
    physics = physics_found(result)
    fewer = [nominal.with_values(as_fitted(result)).with_effects([e for e in physics if e is not one]) for one in physics]
    return hold_instead(found, fewer, recordings, held_out, seconds) if fewer else "held"


def with_taken(log: LogCheck | None, hold: str, recordings: Sequence[Recording]) -> LogCheck | None:
    """The check with what it says of a hold that is taken."""
    if log is None:
        return None
    problem = dataclasses.replace(taken_hold(hold, 1.0 / recordings[0].dt), recording=recordings[0].source)
    return dataclasses.replace(log, problems=(*log.problems, problem))
