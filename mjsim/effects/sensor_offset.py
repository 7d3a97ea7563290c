"""Sensor offset: the measured velocity has a bias.

y = v + y_0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, parameter
from mjsim.effects.ports import OutputMap, Port, StaticMap
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["SensorOffset"]


@register
@dataclass(frozen=True, kw_only=True)
class SensorOffset(Effect):
    """Sensor offset; law, convention and source as in the module's text."""

    id: ClassVar[str] = "sensor_offset"
    places: ClassVar[tuple[str, ...]] = ("sensor",)
    shown_by_angle: ClassVar[bool] = True
    sentence: ClassVar[str] = "The sensor reads {value} when the axis stands still (offset)."
    citation: ClassVar[str] = "ISO 5725"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("value",)
    family: ClassVar[str] = "offset"

    value: float = parameter(Quantity.VELOCITY, "reading at rest")

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (OutputMap(StaticMap.ADD, self.value),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("offset", abs(self.value), 0.0, scales.max_velocity, "the speeds that were reached"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"value": 0.02 * scales.output}]
