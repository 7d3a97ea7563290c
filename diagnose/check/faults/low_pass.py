"""Content that ends well below half the sampling rate: a filtered or interpolated channel, whose differences do not show its
noise."""

from __future__ import annotations

from diagnose.check.content import content_end
from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.spectrum import quantisation_step
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["low_pass"]


@check("low_pass", "low_pass", question="Does the noise reach up to half the sampling rate?")
def low_pass(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Responses whose density falls like that of a filter up to the top of the band."""
    found = []
    for name in ("velocity", "angle"):
        x = getattr(recording, name)
        if x is None or quantisation_step(x) > 0:
            continue
        end = content_end(x, recording.dt)
        if end is not None:
            nyquist = 0.5 / recording.dt
            found.append(
                Problem(
                    name, "low_pass", end, "Hz",
                    f"Above {end:.4g} Hz, {100 * end / nyquist:.0f} % of half the sampling rate, the {name} falls off as behind "
                    "a filter: it was filtered, interpolated or simulated without noise, or impacts cover its noise. Its noise "
                    "level is uncertain.",
                    "log the raw channel, or decimate the log to the rate that its content needs", Severity.LIMITS,
                )
            )  # fmt: skip
    return found
