"""A position command that is bound as torque: the input follows the value of the angle, not its second integral."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["command_as_torque"]


@check("command_as_torque", "command_as_torque", question="Does the input act as a torque?")
def command_as_torque(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The input is the angle some time ahead with a slope near 1, and no torque of the model agrees with it."""
    found = context.following
    if found is None:
        return []
    return [
        Problem(
            "torque", "command_as_torque", found.slope, "1",
            f"The input follows the angle with slope {found.slope:.3g}, {1e3 * found.delay:.3g} ms ahead, which explains "
            f"{100 * found.explained:.1f} % of it: it is a position command, not a torque.",
            "bind the torque (or current, with a gain) as torque; a position command is the input of a servo model", Severity.FIX,
        )
    ]  # fmt: skip
