"""A velocity that is late, or early, against the angle: another clock, or a filter in one of them."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.thresholds import ACTUATOR_DELAY, FOLLOWED, SKEW_FIX, Z95, Z_TEST
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["channel_skew"]


@check("channel_skew", "channel_skew", question="Do angle and velocity share one clock?")
def channel_skew(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The delay of the velocity behind the rate of the angle, beyond the larger of one sample and a filter of 50 Hz."""
    scale, signals = context.scale, context.mended
    pair = scale.evidence.pair if scale is not None else None
    if pair is None or signals is None or pair.explained < FOLLOWED:
        return []
    delay, error, allowed = pair.delay.value, pair.delay.error, max(signals.dt, ACTUATOR_DELAY)
    if not abs(delay) - Z_TEST * error > allowed:
        return []
    fix = delay < 0 or delay > SKEW_FIX
    return [
        Problem(
            "velocity", "channel_skew", delay, "s",
            f"The velocity is {1e3 * abs(delay):.4g} ms {'late' if delay > 0 else 'early'} against the angle (95 % "
            f"{1e3 * (delay - Z95 * error):.4g} to {1e3 * (delay + Z95 * error):.4g} ms).",
            "log both by one clock and without a filter on the velocity, or leave the velocity out of the binding",
            Severity.FIX if fix else Severity.LIMITS, (delay - Z95 * error, delay + Z95 * error),
        )
    ]  # fmt: skip
