"""A channel on the other side of a gear: off by the ratio of the gear in the model."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.faults.scales import chosen, scale_problem
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem
from mjsim.recording import Recording

__all__ = ["side"]


@check("side", "side", question="Are torque and motion on one side of the gear?")
def side(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The hypothesis of this kind that brings the log to the model, where the labels do not."""
    scale = chosen(context, "side")
    return [] if scale is None else scale_problem(scale, context)
