"""Acceleration limit of a servo: its target goes to the command with a bounded acceleration, and brakes in time to stop there.

r'' = A or -A, by which r comes to rest at the command in the shortest time;    the servo acts on the error to r

A drive that moves by trapezoidal profiles has it, beside a velocity limit, which is an effect of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_servo, parameter
from mjsim.effects.ports import CommandAcceleration, Port
from mjsim.effects.registry import register
from mjsim.effects.velocity_limit import VelocityLimit
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["AccelerationLimit"]


@register
@dataclass(frozen=True, kw_only=True)
class AccelerationLimit(Effect):
    """Acceleration limit of a servo; law, convention and source as in the module's text."""

    id: ClassVar[str] = "acceleration_limit"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = "The servo's target speeds up and slows down by no more than {limit_rad_s2}."
    citation: ClassVar[str] = "Biagiotti, Melchiorri, Trajectory Planning for Automatic Machines and Robots (2008), ch. 4"
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ()
    family: ClassVar[str] = "servo"
    multistart: ClassVar[int] = 2

    limit_rad_s2: float = parameter(Quantity.ACCELERATION, "largest acceleration of the target", lower=1e-9)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_servo(chain, position=True)
        return (CommandAcceleration(self.limit_rad_s2),)

    def nearest(self, chain: Chain, speed: float) -> tuple[Chain, tuple[Effect, ...]]:
        """A velocity limit at the speeds of the motion, which holds the target back where it would be ahead."""
        return chain, (VelocityLimit(limit_rad_s=max(2.0 * speed, 1e-9)),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        most = 4.0 * scales.acceleration  # which slopes through many samples of a slow log make too small
        return (Range("acceleration", self.limit_rad_s2, 0.0, most, "four times those that were reached"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: about the largest acceleration of the motion, which runs past its target, and which a slow log does
        not show. Where a command comes before the last one is reached, minima are a fifth apart."""
        return [{"limit_rad_s2": 0.25 * 2.0 ** (k / 4) * scales.acceleration} for k in range(17)]
