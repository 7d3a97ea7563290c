"""Joint spring: a spring between the driven body and the ground, such as a cable, a hose or a balancing spring.

tau = -k (q - q_0)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import ANGLE, law
from mjsim.effects.native import GroundSpring, Native, Value
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["JointSpring"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-k (q - q_0)."""
    out[0] = -p[0] * (z[ANGLE] - p[1])


@register
@dataclass(frozen=True, kw_only=True)
class JointSpring(Effect):
    """Joint spring; law, convention and source as in the module's text."""

    id: ClassVar[str] = "joint_spring"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "A spring pulls the {place} towards one angle, with {stiffness_Nm_rad} (a cable, a hose, a balancing spring)."
    )
    citation: ClassVar[str] = "Spong, Hutchinson, Vidyasagar, Robot Modeling and Control (2006) ch. 7"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("stiffness_Nm_rad",)
    family: ClassVar[str] = "offset"
    refines: ClassVar[tuple[str, ...]] = ("torque_offset",)

    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "torque over deflection", lower=0.0)
    rest_rad: float = parameter(Quantity.ANGLE, "angle at which the spring is at rest")

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (BodyTorque(need_body(chain, self.place), torque, (self.stiffness_Nm_rad, self.rest_rad)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((GroundSpring(need_body(chain, self.place), self.stiffness_Nm_rad, self.rest_rad),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, GroundSpring):
            return None
        return cls(place=chain.bodies[value.body].place, stiffness_Nm_rad=value.stiffness, rest_rad=value.rest)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: beside a weight, which pulls nearly alike, a stiff spring bends the response too much to be scored."""
        return [
            {"stiffness_Nm_rad": part * scales.torque / scales.travel, "rest_rad": 0.5 * scales.travel} for part in (0.2, 0.02)
        ]

    def second_direction(self) -> Self:
        """At rest on the other side: two springs span a spring and an offset."""
        return self.with_values({"rest_rad": -self.rest_rad})

    def combined(self, first: float, second: float) -> tuple[Self, float]:
        """Springs side by side: stiffnesses add up, the rest angle is their mean by stiffness."""
        total = first + second
        least = 1e-3 * max(abs(first), abs(second))  # an offset alone is a soft spring, far off its rest
        if abs(total) < least:
            total = math.copysign(least, total)
        return self.with_values({"rest_rad": self.rest_rad * (first - second) / total}), total
