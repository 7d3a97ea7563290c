"""An input that does not vary, which excites nothing but by a step with the first sample."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context, torque_of
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from diagnose.data.experiment import steps_from_rest
from mjsim.recording import Recording

__all__ = ["constant_input"]


@check("constant_input", "constant_input", question="Does the input vary?")
def constant_input(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The torque has one value throughout. Of an axis at rest at the first sample that is a step, which does excite it."""
    torque = torque_of(recording)
    if torque is None or np.ptp(torque) > 0 or not recording.driven:
        return []
    said, unit = f"The torque is {torque[0]:.6g} in every sample.", "N m" if machine.hinge else "N"
    if steps_from_rest(recording):
        return [
            Problem(
                "torque", "constant_input", float(torque[0]), unit,
                f"{said} The axis starts at rest: it is taken for a step at the first sample.",
                "if it is, add steps of other sizes and of both signs, which tell friction from damping; if it is not, bind the "
                "column that holds the input",
                Severity.LIMITS,
            )
        ]  # fmt: skip
    return [
        Problem(
            "torque", "constant_input", float(torque[0]), unit, said, "bind the column that holds the input, or excite the axis",
            Severity.FIX,
        )
    ]  # fmt: skip
