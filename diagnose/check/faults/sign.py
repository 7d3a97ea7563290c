"""A channel with the opposite sign: the inertia that the log shows is negative, or the angle runs against the velocity."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.faults.scales import chosen, scale_problem
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem
from mjsim.recording import Recording

__all__ = ["sign"]


@check("sign", "sign", question="Do torque and motion have one sign?")
def sign(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The hypothesis of this kind that brings the log to the model, where the labels do not."""
    scale = chosen(context, "sign")
    return [] if scale is None else scale_problem(scale, context)
