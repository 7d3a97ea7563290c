"""Time delay in the command or in the measurement.

tau(t) = u(t - T), or y(t) = v(t - T)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from mjsim.effects.admissible import Range, wait
from mjsim.effects.base import Effect, Scales, need_drive, parameter
from mjsim.effects.native import DriveDelay, Native, SensorDelay, Value
from mjsim.effects.ports import InputDelay, OutputDelay, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["TimeDelay"]


@register
@dataclass(frozen=True, kw_only=True)
class TimeDelay(Effect):
    """Time delay in the command or in the measurement; law, convention and source as in the module's text."""

    id: ClassVar[str] = "time_delay"
    places: ClassVar[tuple[str, ...]] = ("actuator", "sensor")
    once: ClassVar[bool] = True
    sentence: ClassVar[str] = "A time delay of {delay_s} at the {place} (bus, buffer or filter)."
    citation: ClassVar[str] = "Normey-Rico, Camacho, Control of Dead-time Processes (2007)"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("delay_s",)
    family: ClassVar[str] = "signal"

    delay_s: float = parameter(Quantity.TIME, "delay", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        if self.place != "actuator":
            return (OutputDelay(self.delay_s),)
        need_drive(chain)
        return (InputDelay(self.delay_s),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((DriveDelay(self.delay_s) if self.place == "actuator" else SensorDelay(self.delay_s),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        match value:
            case DriveDelay(delay):
                return cls(place="actuator", delay_s=delay)
            case SensorDelay(delay):
                return cls(place="sensor", delay_s=delay)
        return None

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return wait("delay in s", self.delay_s, max(scales.move, scales.dt), "the time of a move", scales)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"delay_s": scales.dt}, {"delay_s": 6 * scales.dt}]
