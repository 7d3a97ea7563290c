"""Actuator saturation: the drive's torque limit.

tau = clip(u, -L, L); of a servo, u is the force that its law asks for. A limit of the motor's current (``current_limit``) is this
effect: with tau = kt i, the current limit is L / kt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_drive, parameter
from mjsim.effects.native import DriveLimit, Native, Value
from mjsim.effects.ports import DriveLimit as ForceLimit
from mjsim.effects.ports import InputMap, Port, StaticMap
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["ActuatorSaturation"]


@register
@dataclass(frozen=True, kw_only=True)
class ActuatorSaturation(Effect):
    """Actuator saturation; law, convention and source as in the module's text."""

    id: ClassVar[str] = "actuator_saturation"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = "The actuator saturates: it delivers no more than {limit_Nm}."
    citation: ClassVar[str] = "Hippe, Windup in Control (2006)"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ()
    family: ClassVar[str] = "signal"

    limit_Nm: float = parameter(Quantity.TORQUE, "largest torque delivered", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_drive(chain)
        if chain.servo is not None:
            return (ForceLimit(self.limit_Nm),)
        return (InputMap(StaticMap.CLIP, self.limit_Nm),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((DriveLimit(self.limit_Nm),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        return cls(limit_Nm=value.limit) if isinstance(value, DriveLimit) else None

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        most = scales.asked[0] if scales.asked else scales.max_input
        return (Range("limit", self.limit_Nm, 0.0, most, "the largest force that was asked for"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: limits of the peaks, and limits that act in a tenth and in three tenths of the time."""
        most, *often = scales.asked or (scales.max_input,)
        levels = [c * most for c in (0.97, 0.9, 0.75, 0.6)]
        return [{"limit_Nm": level} for level in (*levels, *(x for x in often if x < levels[-1]))]
