"""The log of one joint before and after the search: the check of a servo's, and how the input of any goes between samples."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from diagnose.check import LogCheck
from diagnose.check.faults.hold import shift_of
from diagnose.evidence.rivals.quantisation import within_the_step
from diagnose.fit.command_hold import WORDS, hold_instead, input_channel, is_assumed, shown_hold, taken_hold, with_hold
from diagnose.pipeline import Options, diagnose
from diagnose.progress import Step
from diagnose.result import Diagnosis, Verdict
from diagnose.robot.check.axis import check_servo_axis
from diagnose.thresholds import FAIR, UNEXPLAINED
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.effects.admissible import BETWEEN
from mjsim.hold import HOLDS
from mjsim.ode import DivergedError
from mjsim.recording import Recording
from mjsim.robot.model import load_robot
from simgap.found import as_fitted, corrected_axis, physics_found

__all__ = ["another_hold", "checked_servo", "hold_beside", "later_hold", "with_taken"]


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
    result: Diagnosis, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options,
    say: Callable[[Step], None] = lambda _: None, level: float = UNEXPLAINED,
) -> str:  # fmt: skip
    """The hold of the input that shows beside the structure that was found; that of the recordings where none does.

    Of a held command that is one that leaves less where the effects leave more than noise, and one that explains as much as one
    of the effects; of a held torque, where no effect was found. Else, of a servo, one under which a short search finds a
    structure that leaves less, where more than ``level`` times the noise variance is left: an error of the hold hides effects.
    """
    began, own = time.monotonic(), recordings[0].hold
    shown = _hold_of_structure(result, nominal, recordings, held_out, options)
    within = options.since(began)
    if shown != own or nominal.chain.servo is None or not _is_open([*recordings, *held_out]) or not within.seconds > 0:
        return shown
    return _searched_hold(result, nominal, recordings, held_out, within, say) if _is_far(result, level) else own


def another_hold(
    nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options
) -> Callable[[Diagnosis], bool]:
    """Whether beside the structure of a diagnosis another hold of the command shows; the short searches are left out."""
    began = time.monotonic()

    def shows(result: Diagnosis) -> bool:
        return _hold_of_structure(result, nominal, recordings, held_out, options.since(began)) != recordings[0].hold

    return shows


def _hold_of_structure(
    result: Diagnosis, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options
) -> str:
    """The hold that shows by the structure that was found (`hold_beside`)."""
    own, every = recordings[0].hold, [*recordings, *held_out]
    if result.channel == "torque" or not _is_open(every) or not options.seconds > 0:
        return own
    if (later := later_hold(result, every)) != own:
        return later
    began, physics = time.monotonic(), physics_found(result)
    if own != "held" or (physics and nominal.chain.servo is None):
        return own
    shown = shown_hold(corrected_axis(nominal, result), recordings, held_out, options.seconds) if _is_far(result) else own
    if shown == own and physics:
        given = nominal.with_values(as_fitted(result))
        fewer = [given.with_effects([e for e in physics if e is not one]) for one in physics]
        shown = hold_instead(corrected_axis(nominal, result), fewer, recordings, held_out, options.since(began).seconds)
    return shown


def _is_far(result: Diagnosis, level: float = UNEXPLAINED) -> bool:
    """Whether more than ``level`` times the noise variance is left, beyond the step of an encoder, or it is not explained."""
    left = result.fit["corrected"].rms ** 2 > level * result.noise_floor**2 > 0 and not within_the_step(result)
    return left or result.verdict is Verdict.UNEXPLAINED


def later_hold(result: Diagnosis, recordings: Sequence[Recording]) -> str:
    """The later hold whose delay equals that of the delays and lags that were found, to a quarter of a sample.

    Beside it these are too short to be named. That of the recordings where there is none, or where it is stated. Not a held
    command, with which every other hold was compared before it was taken.
    """
    own, dt, waits = recordings[0].hold, recordings[0].dt, _waits(result)
    later = [h for h in HOLDS if h != "held" and shift_of(h, own) > 0.0 and abs(waits - shift_of(h, own) * dt) < BETWEEN * dt]
    return later[0] if later and _is_open(recordings) else own


def _is_open(recordings: Sequence[Recording]) -> bool:
    """Whether all recordings have an input of one hold, which none states."""
    return all(r.driven and r.hold == recordings[0].hold and not r.hold_stated for r in recordings)


def _searched_hold(
    result: Diagnosis, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options,
    say: Callable[[Step], None],
) -> str:  # fmt: skip
    """The hold under which a search of a quarter of the simulations leaves a quarter less of the squared error.

    Of that of estimation and held-out samples together, and no more of either; that of the recordings where none does. A hold
    adds no number, so that both show it, and one alone may be near the noise under any. Not one under which the command acts
    earlier and a delay or lag makes up for that: by the present hold it would be too short to be named.
    """
    short, own = dataclasses.replace(options, effort=FAIR * options.effort), recordings[0].hold
    began, least = time.monotonic(), {own: result.fit["corrected"]}
    for hold in HOLDS:
        if hold == own or not options.since(began).seconds:
            continue
        say(Step("search", f"briefly, as if the command {WORDS[hold]}"))
        with contextlib.suppress(DivergedError):
            other = diagnose(
                nominal, with_hold(recordings, hold), with_hold(held_out, hold), short.since(began), say, surpassed=lambda _: True
            )
            lead = -shift_of(hold, own)
            if lead <= 0.0 or not 0.0 < _waits(other) < (lead + BETWEEN) * recordings[0].dt:
                least[hold] = other.fit["corrected"]

    def ratio(hold: str) -> float:
        """Of the squared errors of all samples under two holds; infinite where one leaves more of either kind."""
        one, present = least[hold], least[own]
        if one.rms > present.rms or one.held_out_rms > present.held_out_rms:
            return math.inf
        return (one.rms**2 + one.held_out_rms**2) / (present.rms**2 + present.held_out_rms**2)

    best = min(least, key=ratio)
    return best if ratio(best) < 1.0 - FAIR else own


def _waits(result: Diagnosis) -> float:
    """The sum of the delays and lags that were found [s]."""
    amplitudes = [(f, name) for f in result.findings for name in effect_class(f.law).amplitudes]
    return sum(f.parameters[name].value for f, name in amplitudes if f.parameters[name].unit == "s")


def with_taken(log: LogCheck | None, hold: str, recordings: Sequence[Recording]) -> LogCheck | None:
    """The check with what it says of a hold that is taken, and without what it said of another."""
    if log is None:
        return None
    first = recordings[0]
    others = [p for p in log.problems if (p.channel, p.problem) != (input_channel(first), "hold")]
    if hold != "held":
        others.append(dataclasses.replace(taken_hold(hold, 1.0 / first.dt, input_channel(first)), recording=first.source))
    return dataclasses.replace(log, problems=tuple(others))
