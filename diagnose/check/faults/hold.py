"""How the input goes between samples, where the data tell: held, linear, or logged as a mean over the interval before."""

from __future__ import annotations

from dataclasses import dataclass

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.relation import HOLDS
from diagnose.check.thresholds import FOLLOWED, HOLD_TOLERANCE, Z95, Z_TEST
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["Told", "hold", "nearest_hold", "shift_of", "tell_hold"]

_CENTRE = {"held": 0.5, "linear": 0.0, "mean": -0.5}  # delay of the input behind its samples, in samples


@dataclass(frozen=True)
class Told:
    """The hold that the data show, or None where they do not tell; the shift against the stated one [samples], its error."""

    hold: str | None
    shift: float
    error: float


def tell_hold(context: Context) -> Told | None:
    """The hold whose delay the relation has, within a quarter of a sample of it; None without a fit.

    The three differ by half a sample in delay. A delay that is none of them is no hold.
    """
    fit, signals = context.fit, context.mended
    if fit is None or signals is None or fit.explained < FOLLOWED or context.is_command:
        return None
    shift = (fit.delay.value - context.machine.input_lag()) / signals.dt
    error = fit.delay.error / signals.dt
    if Z_TEST * error > HOLD_TOLERANCE:
        return Told(None, shift, error)
    nearest = nearest_hold(shift, context.hold)
    off = abs(shift - shift_of(nearest, context.hold))
    return Told(nearest if off < HOLD_TOLERANCE else None, shift, error)


def nearest_hold(shift: float, assumed: str) -> str:
    """The hold whose delay against the assumed one is nearest to a shift [samples]."""
    return min(HOLDS, key=lambda h: abs(shift - shift_of(h, assumed)))


def shift_of(hold: str, assumed: str) -> float:
    """Delay of a hold against the assumed one [samples]."""
    return _CENTRE[hold] - _CENTRE[assumed]


@check("hold", "hold", question="Does the input go between samples as stated?")
def hold(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """A hold other than the stated one (held where none is stated)."""
    told = tell_hold(context)
    if told is None or told.hold is None or told.hold == context.hold:
        return []
    signals = context.mended
    assert signals is not None
    if machine.input_lag() == 0 and told.shift > 0:
        return []  # late by half a sample: a drive does that as well
    low, high = told.shift - Z95 * told.error, told.shift + Z95 * told.error
    stated = "stated" if context.hold_is_stated else "assumed"
    word = {
        "held": "held over each sample",
        "linear": "linear between samples",
        "mean": "logged as the mean over the interval before",
    }
    return [
        Problem(
            "torque", "hold", told.shift, "samples",
            f"The input is {word[told.hold]}, not {context.hold} as {stated}: the response is {-told.shift:.3g} samples earlier "
            f"(95 % {-high:.3g} to {-low:.3g}).",
            f'state [recording] hold = "{told.hold}"', Severity.LIMITS, (low, high),
        )
    ]  # fmt: skip
