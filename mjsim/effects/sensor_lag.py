"""Sensor lag: a first-order filter in the measurement.

T y' + y = v
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.effects.admissible import Range, wait
from mjsim.effects.base import Effect, Scales, parameter
from mjsim.effects.ports import OutputLag, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["SensorLag"]


@register
@dataclass(frozen=True, kw_only=True)
class SensorLag(Effect):
    """Sensor lag; law, convention and source as in the module's text."""

    id: ClassVar[str] = "sensor_lag"
    places: ClassVar[tuple[str, ...]] = ("sensor",)
    sentence: ClassVar[str] = "The sensor lags by {time_constant_s} (a filter in the measurement)."
    citation: ClassVar[str] = "Franklin, Powell, Emami-Naeini, Feedback Control (2015)"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("time_constant_s",)
    family: ClassVar[str] = "signal"

    time_constant_s: float = parameter(Quantity.TIME, "time constant", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (OutputLag(self.time_constant_s),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return wait("time constant in s", self.time_constant_s, 5.0 * scales.move, "a few moves", scales)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"time_constant_s": 2 * scales.dt}, {"time_constant_s": 10 * scales.dt}]
