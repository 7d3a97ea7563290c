"""Actuator dead zone: small commands are not delivered.

tau = u - clip(u, -w, w)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_torque_input, parameter
from mjsim.effects.ports import InputMap, Port, StaticMap
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["ActuatorDeadzone"]


@register
@dataclass(frozen=True, kw_only=True)
class ActuatorDeadzone(Effect):
    """Actuator dead zone; law, convention and source as in the module's text."""

    id: ClassVar[str] = "actuator_deadzone"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = (
        "The actuator has a dead zone: commands within {half_width_Nm} produce nothing, larger ones that much less."
    )
    citation: ClassVar[str] = "Tao, Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996)"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("half_width_Nm",)
    family: ClassVar[str] = "signal"

    half_width_Nm: float = parameter(Quantity.TORQUE, "half the width of the zone", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_torque_input(chain)
        return (InputMap(StaticMap.DEAD, self.half_width_Nm),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("half width", self.half_width_Nm, 0.0, scales.max_input, "the largest command"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"half_width_Nm": c * scales.input} for c in (0.05, 0.3)]
