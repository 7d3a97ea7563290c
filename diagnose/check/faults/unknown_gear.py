"""An angle of the motor's side of a gear that the model does not state."""

from __future__ import annotations

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording

__all__ = ["unknown_gear"]


@check("unknown_gear", "gear_ratio", question="Is the angle that of the joint?")
def unknown_gear(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """The ratio at which the recorded torque has the weight of the model."""
    found = context.gear
    if found is None:
        return []
    return [
        Problem(
            "angle", "gear_ratio", found.ratio, "1",
            f"The angle is on the fast side of a gear of about {found.ratio:.3g}, which the model does not state: the torque "
            f"then has the weight of the model, and {100 * found.explained:.1f} % of it is explained instead of "
            f"{100 * found.labelled:.1f} %.",
            f"bind angle with gain = 1 / ratio (about {1 / found.ratio:.3g}); take the ratio from the data sheet", Severity.FIX,
        )
    ]  # fmt: skip
