"""Sensor quantisation: the measured velocity comes in steps.

y = step round(v / step)
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

__all__ = ["SensorQuantisation"]


@register
@dataclass(frozen=True, kw_only=True)
class SensorQuantisation(Effect):
    """Sensor quantisation; law, convention and source as in the module's text."""

    id: ClassVar[str] = "sensor_quantisation"
    places: ClassVar[tuple[str, ...]] = ("sensor",)
    sentence: ClassVar[str] = "The sensor reports in steps of {step}."
    citation: ClassVar[str] = "Widrow, Kollar, Quantization Noise (2008)"
    tolerance: ClassVar[float] = 1e-3  # one sample that rounds the other way is 1e-4; measured 4e-5
    amplitudes: ClassVar[tuple[str, ...]] = ()
    family: ClassVar[str] = "signal"
    rounds: ClassVar[bool] = True

    step: float = parameter(Quantity.VELOCITY, "step of the reported velocity", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (OutputMap(StaticMap.ROUND, self.step),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        if not scales.steps:
            return (Range("step", self.step, 0.0, 0.0, "since the samples come in no steps"),)
        near = min(scales.steps, key=lambda step: abs(step - self.step))
        return (Range("step", self.step, near / 1.25, near * 1.25, "the steps in which the samples come"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        if scales.steps:
            return [{"step": step} for step in scales.steps]
        return [{"step": scales.output * 10**e} for e in (-2.5, -2.25, -2.0, -1.75, -1.5, -1.25, -1.0)]
