"""Actuator lag: the current loop's first-order response.

T tau' + tau = u
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from mjsim.effects.admissible import Range, wait
from mjsim.effects.base import Effect, Scales, need_drive, parameter
from mjsim.effects.native import DriveLag, Native, Value
from mjsim.effects.ports import InputLag, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["ActuatorLag"]


@register
@dataclass(frozen=True, kw_only=True)
class ActuatorLag(Effect):
    """Actuator lag; law, convention and source as in the module's text."""

    id: ClassVar[str] = "actuator_lag"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = "The actuator follows its command with a lag of {time_constant_s} (current loop)."
    citation: ClassVar[str] = "Franklin, Powell, Emami-Naeini, Feedback Control (2015)"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("time_constant_s",)
    family: ClassVar[str] = "signal"

    time_constant_s: float = parameter(Quantity.TIME, "time constant", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_drive(chain)
        return (InputLag(self.time_constant_s),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((DriveLag(self.time_constant_s),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        return cls(time_constant_s=value.time_constant) if isinstance(value, DriveLag) else None

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return wait("time constant in s", self.time_constant_s, 5.0 * scales.move, "a few moves", scales)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"time_constant_s": 2 * scales.dt}, {"time_constant_s": 10 * scales.dt}]
