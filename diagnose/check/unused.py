"""Which recorded channels a diagnosis does not fit, in words."""

from __future__ import annotations

from collections.abc import Iterable

from mjsim.recording import Recording
from mjsim.robot.recording import RobotRecording

__all__ = ["unused_channels", "unused_of_robot"]

SECOND_VELOCITY = "second_velocity (behind the gear) is not used: the motor's side is fitted and judged."
COMPARED = (
    "second_angle (behind the gear) is not fitted: where a held-out recording has it too, its difference from the motor's angle "
    "is examined for a delay, wind-up, backlash and hysteresis. The motor's side is judged."
)
NO_ANGLE = "second_angle (behind the gear) is not used: no recording has the angle of the motor beside it."
NO_TORQUE = "second_angle (behind the gear) is not used: the comparison with the motor needs a recorded torque and a <motor>."
READ_ONLY = {
    "current": "current is not used: bind it as torque, with gain = the torque per ampere, where no torque is recorded.",
    "supply": "supply is not used: no effect depends on the supply voltage.",
}


def unused_channels(recordings: Iterable[Recording], *, servo: bool) -> tuple[str, ...]:
    """One sentence for each channel of the recordings that the fit leaves out; ``servo``: whether the model's input is a command.

    `diagnose.explain.second_encoder` compares a second encoder where angle and torque are recorded beside it.
    """
    every = list(recordings)
    said = []
    second = [r for r in every if r.second_angle is not None]
    if second:
        said.append(NO_TORQUE if servo else COMPARED if any(r.angle is not None for r in second) else NO_ANGLE)
    if any(r.second_velocity is not None for r in every):
        said.append(SECOND_VELOCITY)
    return (*said, *(text for role, text in READ_ONLY.items() if any(getattr(r, role) is not None for r in every)))


def unused_of_robot(recordings: Iterable[RobotRecording]) -> tuple[str, ...]:
    """One sentence for each channel of a robot's recordings that no fit of a robot uses."""
    every = list(recordings)
    there = [name for name in ("second_angle", "current") if any(getattr(r, name) is not None for r in every)]
    return tuple(f"{name} is not used: the angle of each joint is fitted and judged." for name in there)
