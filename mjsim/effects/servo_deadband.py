"""Dead band of a servo: its proportional part does nothing while the error is small.

force = kp (e - clip(e, -w, w)) - kv l',    e: the error of the servo
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_servo, parameter
from mjsim.effects.ports import CommandDeadBand, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["ServoDeadband"]


@register
@dataclass(frozen=True, kw_only=True)
class ServoDeadband(Effect):
    """Dead band of a servo; law, convention and source as in the module's text."""

    id: ClassVar[str] = "servo_deadband"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = "The servo has a dead band: it does not react to errors within {half_width_rad} to either side."
    citation: ClassVar[str] = "Feetech, STS3215 memory table (2020), CW and CCW dead band"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("half_width_rad",)
    family: ClassVar[str] = "servo"

    half_width_rad: float = parameter(Quantity.ANGLE, "error to either side without reaction", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_servo(chain, position=True)
        return (CommandDeadBand(self.half_width_rad),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("half width", self.half_width_rad, 0.0, scales.travel, "the travel"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"half_width_rad": c * (scales.following or 0.01 * scales.travel)} for c in (0.1, 0.5)]
