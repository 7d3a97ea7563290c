"""Quadratic (drag) friction.

tau_f = c v |v|
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import RATE, law
from mjsim.effects.native import Native, SquareDrag, Value
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["QuadraticFriction"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-c v |v|."""
    out[0] = -p[0] * z[RATE] * abs(z[RATE])


@register
@dataclass(frozen=True, kw_only=True)
class QuadraticFriction(Effect):
    """Quadratic; law, convention and source as in the module's text."""

    id: ClassVar[str] = "quadratic_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Friction at the {place} that grows with the square of the speed (coefficient {coefficient_Nm_s2_rad2}), as churning or windage does."
    )
    citation: ClassVar[str] = "Swevers, Verdonck, De Schutter, IEEE Control Systems 27 (2007) 58"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("coefficient_Nm_s2_rad2",)
    family: ClassVar[str] = "speed"

    coefficient_Nm_s2_rad2: float = parameter(Quantity.QUADRATIC_DAMPING, "torque over speed squared", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (BodyTorque(need_body(chain, self.place), torque, (self.coefficient_Nm_s2_rad2,)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((SquareDrag(need_body(chain, self.place), self.coefficient_Nm_s2_rad2),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, SquareDrag):
            return None
        return cls(place=chain.bodies[value.body].place, coefficient_Nm_s2_rad2=value.coefficient)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"coefficient_Nm_s2_rad2": 0.05 * scales.torque / scales.velocity**2}]
