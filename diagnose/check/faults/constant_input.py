"""An input that does not vary excites nothing."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context, torque_of
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["constant_input"]


@check("constant_input", "constant_input", question="Does the input vary?")
def constant_input(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The torque has one value throughout."""
    torque = torque_of(recording)
    if torque is None or np.ptp(torque) > 0 or not recording.driven:
        return []
    return [
        Problem(
            "torque", "constant_input", float(torque[0]), "N m" if machine.hinge else "N",
            f"The torque is {torque[0]:.6g} in every sample.", "bind the column that holds the input, or excite the axis",
            Severity.FIX,
        )
    ]  # fmt: skip
