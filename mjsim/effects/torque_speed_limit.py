"""Torque-speed limit of a motor: its back-EMF leaves less voltage for torque as it turns.

-T (1 + v / V) <= tau <= T (1 - v / V),    T: stall torque, V: no-load speed, v: speed of the actuator
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_servo, parameter
from mjsim.effects.native import Native, SpeedLine, Value
from mjsim.effects.ports import Port, TorqueSpeedLine
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["TorqueSpeedLimit"]


@register
@dataclass(frozen=True, kw_only=True)
class TorqueSpeedLimit(Effect):
    """Torque-speed limit; law, convention and source as in the module's text."""

    id: ClassVar[str] = "torque_speed_limit"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = (
        "The motor's torque is limited by its speed: {stall_torque_Nm} at rest, none at {no_load_speed_rad_s} (back-EMF)."
    )
    citation: ClassVar[str] = "Krause, Wasynczuk, Sudhoff, Analysis of Electric Machinery (2002), ch. 2"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ()
    family: ClassVar[str] = "servo"

    stall_torque_Nm: float = parameter(Quantity.TORQUE, "torque limit at rest", lower=1e-12)
    no_load_speed_rad_s: float = parameter(Quantity.VELOCITY, "speed at which no torque is left", lower=1e-9)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_servo(chain)
        return (TorqueSpeedLine(self.stall_torque_Nm, self.no_load_speed_rad_s),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        need_servo(chain)
        return Native((SpeedLine(self.stall_torque_Nm, self.no_load_speed_rad_s),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        return cls(stall_torque_Nm=value.stall, no_load_speed_rad_s=value.no_load) if isinstance(value, SpeedLine) else None

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        why = "from the usual speed on, beyond which the motor would brake in most samples"
        return (Range("no-load speed", self.no_load_speed_rad_s, scales.velocity, math.inf, why),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: torque at rest and speed as multiples of the largest that occur."""
        return [
            {"stall_torque_Nm": t * scales.max_torque, "no_load_speed_rad_s": v * scales.max_velocity}
            for t, v in ((0.9, 2.0), (0.6, 2.0), (1.2, 1.3))
        ]
