"""Velocity feedforward of a position servo: beside kp and kv it has a force in proportion to the speed of its target.

force = kp e - kv l' + k r',    r: the target that the servo follows, e: its error

A controller that differentiates its error, and not the position alone, has k = kv; so has a cascade of a position and a velocity
loop with full velocity feedforward. The force of a step of a command that is held is spread over the sample that follows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.effects.admissible import Range, servo_stiffness
from mjsim.effects.base import Effect, Scales, need_servo, parameter
from mjsim.effects.ports import CommandLead, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["VelocityFeedforward"]


@register
@dataclass(frozen=True, kw_only=True)
class VelocityFeedforward(Effect):
    """Velocity feedforward of a position servo; law, convention and source as in the module's text."""

    id: ClassVar[str] = "velocity_feedforward"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = "The servo has a velocity feedforward: beside kp and kv, {gain_Nms_rad} on the speed of its target."
    citation: ClassVar[str] = "G. Ellis, Control System Design Guide (2012), ch. 8; MuJoCo XML reference, actuator/pid"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("gain_Nms_rad",)
    family: ClassVar[str] = "servo"

    gain_Nms_rad: float = parameter(Quantity.DAMPING, "force of the actuator per speed of the target", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_servo(chain, position=True)
        assert chain.servo is not None
        return (CommandLead(self.gain_Nms_rad / chain.servo.kp),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it: a command may act a sample earlier by the way that it goes between samples."""
        lead = self.gain_Nms_rad / servo_stiffness(scales)
        return (
            Range(
                "lead", lead, scales.dt, math.inf, "a sample, by which a command may be ahead that is not held as assumed", True
            ),
        )

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: at the speeds of the motion, a part of the largest torque."""
        return [{"gain_Nms_rad": c * scales.max_torque / scales.max_velocity} for c in (0.1, 0.5)]
