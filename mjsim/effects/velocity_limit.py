"""Velocity limit of a servo: its target follows the command no faster than a limit.

r' = clip((c - r) / 0+, -V, V),    the servo acts on the error to r
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_servo, parameter
from mjsim.effects.native import CommandSlew as Slew
from mjsim.effects.native import Native, Value
from mjsim.effects.ports import CommandSlew, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["VelocityLimit"]


@register
@dataclass(frozen=True, kw_only=True)
class VelocityLimit(Effect):
    """Velocity limit of a servo; law, convention and source as in the module's text."""

    id: ClassVar[str] = "velocity_limit"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = "The servo follows its command no faster than {limit_rad_s}."
    citation: ClassVar[str] = "Biagiotti, Melchiorri, Trajectory Planning for Automatic Machines and Robots (2008), ch. 4"
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ()
    family: ClassVar[str] = "servo"

    limit_rad_s: float = parameter(Quantity.VELOCITY, "largest speed of the target", lower=1e-9)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_servo(chain, position=True)
        return (CommandSlew(self.limit_rad_s),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        need_servo(chain, position=True)
        return Native((Slew(self.limit_rad_s),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        return cls(limit_rad_s=value.limit) if isinstance(value, Slew) else None

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("speed", self.limit_rad_s, 0.0, 2.0 * scales.max_velocity, "twice the speeds that were reached"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: below the fastest motion, at it, and above it."""
        return [{"limit_rad_s": c * scales.max_velocity} for c in (0.5, 0.75, 1.0)]
