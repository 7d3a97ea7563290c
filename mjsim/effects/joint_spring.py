"""Joint spring: a spring between the driven body and the ground, such as a cable, a hose or a balancing spring.

tau = tau_0 - k q,    at rest where q = tau_0 / k
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
    """tau_0 - k q."""
    out[0] = p[1] - p[0] * z[ANGLE]


@register
@dataclass(frozen=True, kw_only=True)
class JointSpring(Effect):
    """Joint spring; law, convention and source as in the module's text."""

    id: ClassVar[str] = "joint_spring"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "A spring pulls the {place} towards one angle, with {stiffness_Nm_rad}, and with {torque_at_zero_Nm} where its angle is zero "
        "(a cable, a hose, a balancing spring)."
    )
    citation: ClassVar[str] = "Spong, Hutchinson, Vidyasagar, Robot Modeling and Control (2006) ch. 7"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("stiffness_Nm_rad", "torque_at_zero_Nm")
    sizes: ClassVar[tuple[str, ...]] = ("stiffness_Nm_rad",)
    linear: ClassVar[bool] = True
    family: ClassVar[str] = "offset"
    refines: ClassVar[tuple[str, ...]] = ("torque_offset",)

    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "torque over deflection", lower=0.0)
    torque_at_zero_Nm: float = parameter(Quantity.TORQUE, "torque of the spring at angle zero: stiffness times angle at rest")

    @property
    def rest(self) -> float:
        """Angle at which the spring is at rest [rad | m]; zero where it has no stiffness."""
        return self.torque_at_zero_Nm / self.stiffness_Nm_rad if self.stiffness_Nm_rad else 0.0

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (BodyTorque(need_body(chain, self.place), torque, (self.stiffness_Nm_rad, self.torque_at_zero_Nm)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((GroundSpring(need_body(chain, self.place), self.stiffness_Nm_rad, self.rest),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, GroundSpring):
            return None
        return cls(
            place=chain.bodies[value.body].place, stiffness_Nm_rad=value.stiffness, torque_at_zero_Nm=value.stiffness * value.rest
        )

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: beside a weight, which pulls nearly alike, a stiff spring bends the response too much to be scored."""
        levels = (part * scales.torque for part in (0.2, 0.02))
        return [{"stiffness_Nm_rad": level / scales.travel, "torque_at_zero_Nm": 0.5 * level} for level in levels]

    def second_direction(self) -> Self:
        """At rest on the other side: two springs span a spring and an offset."""
        return self.with_values({"torque_at_zero_Nm": -self.torque_at_zero_Nm})

    def combined(self, first: float, second: float) -> tuple[Self, float]:
        """Springs side by side: their numbers add up."""
        total = first + second
        least = 1e-3 * max(abs(first), abs(second))  # an offset alone is a soft spring, far off its rest
        if abs(total) < least:
            total = math.copysign(least, total)
        return self.with_values({"torque_at_zero_Nm": self.torque_at_zero_Nm * (first - second) / total}), total
