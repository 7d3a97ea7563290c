"""Torque and a response that are one column, up to a factor: a binding error."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context, torque_of
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["same_column"]

_ROUNDING = 1e-9  # relative rms of the difference: two channels of two sensors never agree to nine digits


@check("same_column", "same_column", question="Are the channels columns of their own?")
def same_column(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Two channels are proportional to the last digit."""
    given = {"torque": torque_of(recording), "velocity": recording.velocity, "angle": recording.angle}
    channels = {n: x for n, x in given.items() if x is not None and np.ptp(x) > 0}
    names, found = list(channels), []
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            x, y = channels[a], channels[b]
            factor = float(x @ y) / float(x @ x)
            if float(np.sqrt(np.mean((y - factor * x) ** 2))) <= _ROUNDING * float(np.sqrt(np.mean(y**2))):
                found.append(
                    Problem(
                        b, "same_column", factor, "1", f"The {b} is the {a} times {factor:.6g} in every sample.",
                        f"bind {b} to its own column", Severity.FIX,
                    )
                )  # fmt: skip
    return found
