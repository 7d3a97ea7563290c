"""A response that is late, or early, against the torque by more than one sample and the lag of a drive explain."""

from __future__ import annotations

import math

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.thresholds import ACTUATOR_DELAY, FOLLOWED, SKEW_FIX, Z95, Z_TEST
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["skew"]


@check("skew", "skew", question="Do torque and motion share one clock?")
def skew(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The delay of the relation beyond the model's own and the larger of one sample and a torque loop's lag.

    Its error is that of the fit and what differs between the halves of the recording.
    """
    fit, signals = context.fit, context.mended
    if fit is None or signals is None or fit.explained < FOLLOWED or context.is_command:
        return []
    delay, error = fit.delay.value - machine.input_lag(), fit.delay.error
    allowed = max(signals.dt, ACTUATOR_DELAY)
    if not abs(delay) - Z_TEST * error > allowed:
        return []
    if delay > 0 and fit.count * math.log(fit.over_lag) < Z_TEST**2:
        return []  # a first-order lag of the drive or the sensor explains it as well: physics, for the diagnosis to name
    if not abs(delay) - Z_TEST * error - context.delay_spread > allowed:
        return []  # the halves of the recording differ by as much: physics that was left out, and no delay
    if fit.plain_over_none < 1.0 or not fit.inertia.value > Z_TEST * fit.inertia.error:
        return []  # without a delay the relation is closer, or at the delay the machine has no inertia: narrow excitation
    late = delay > 0
    fix = not late or delay > SKEW_FIX
    name = context.response
    word = "late" if late else "early"
    what = "the clocks of the two channels differ" if fix else "a skew of the clocks and a transport delay look alike"
    return [
        Problem(
            name, "skew", delay, "s",
            f"The {name} is {1e3 * abs(delay):.4g} ms {word} against the torque (95 % {1e3 * (delay - Z95 * error):.4g} to "
            f"{1e3 * (delay + Z95 * error):.4g} ms); one sample and a drive explain {1e3 * allowed:.3g} ms: {what}.",
            f"shift the stamps of the {name} by {-1e3 * delay:.4g} ms, or log both channels by one clock; if the drive does "
            "delay by that much, put the delay into the model", Severity.FIX if fix else Severity.LIMITS,
            (delay - Z95 * error, delay + Z95 * error),
        )
    ]  # fmt: skip
