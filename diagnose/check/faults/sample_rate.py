"""The sample rate against the modes of the model."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.thresholds import MODE_RATE
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["sample_rate"]


@check("sample_rate", "sample_rate", question="Is the log fast enough for the modes of the model?")
def sample_rate(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Modes at or above Nyquist / 2.5, each with its frequency."""
    mended = context.mended
    rate = 1 / (mended.dt if mended is not None else recording.dt)
    reach = rate / MODE_RATE
    return [
        Problem(
            "time", "sample_rate", mode, "Hz",
            f"The mode at {mode:.4g} Hz is out of reach of {rate:.6g} samples/s: modes below {reach:.4g} Hz are within reach.",
            f"log at {MODE_RATE * mode:.4g} samples/s or more, or keep the stiffness and damping behind this mode as they are",
            Severity.LIMITS,
        )
        for mode in machine.modes if mode >= reach
    ]  # fmt: skip
