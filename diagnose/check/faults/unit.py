"""A channel in another unit than its label says: degrees, rpm, milliseconds, millimetres, kilonewton metres."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.faults.scales import chosen, scale_problem
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem
from mjsim.recording import Recording

__all__ = ["unit"]


@check("unit", "unit", question="Are the units those of the labels?")
def unit(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The hypothesis of this kind that brings the log to the model, where the labels do not."""
    scale = chosen(context, "unit")
    return [] if scale is None else scale_problem(scale, context)
