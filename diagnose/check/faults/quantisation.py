"""Rounding that is coarser than the noise: the noise is then that of the rounding, and differences do not show it."""

from __future__ import annotations

import math

import numpy as np

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.spectrum import quantisation_step
from diagnose.check.thresholds import EQUAL_NEIGHBOURS
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["quantisation"]


@check("quantisation", "quantisation", question="Is the noise above the rounding?")
def quantisation(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Channels that stand still between coarse steps while the axis moves."""
    units = {"velocity": "rad/s" if machine.hinge else "m/s", "angle": "rad" if machine.hinge else "m"}
    found = []
    for name, unit in units.items():
        x = getattr(recording, name)
        if x is None:
            continue
        step = quantisation_step(x)
        still = float(np.mean(np.diff(x) == 0))
        if step > 0 and still > EQUAL_NEIGHBOURS:
            found.append(
                Problem(
                    name, "quantisation", step, unit,
                    f"The {name} moves in steps of {step:.4g} {unit}; {100 * still:.0f} % of neighbours are equal, so the "
                    f"noise is below the step and the floor is its rounding, {step / math.sqrt(12):.3g} {unit} rms.",
                    "log the raw counts at their full resolution, or raise the sensor's resolution", Severity.LIMITS,
                )
            )  # fmt: skip
    return found
