"""Presliding friction (Dahl, the LuGre model without Stribeck and micro-damping): a bristle that yields.

tau_f = s z,  z' = v - s |v| z / F
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.admissible import Range, bristles
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import RATE, STATE, law
from mjsim.effects.native import BodyBristle, Native, Value
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["PreslidingFriction"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-s z; alpha = v, beta = s |v| / F."""
    out[0] = -p[1] * z[STATE]
    out[1] = z[RATE]
    out[2] = p[1] * abs(z[RATE]) / p[0]


@register
@dataclass(frozen=True, kw_only=True)
class PreslidingFriction(Effect):
    """Presliding friction; law, convention and source as in the module's text."""

    id: ClassVar[str] = "presliding_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Friction at the {place} that acts as a spring of {stiffness_Nm_rad} before it slides at {torque_Nm} (presliding)."
    )
    citation: ClassVar[str] = "P. Dahl 1968; Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 40 (1995) 419"
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "stiffness_Nm_rad")
    family: ClassVar[str] = "friction"
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction",)

    torque_Nm: float = parameter(Quantity.TORQUE, "sliding level", lower=1e-12)
    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "stiffness of the contact at rest", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (BodyTorque(need_body(chain, self.place), torque, (self.torque_Nm, self.stiffness_Nm_rad), state=True),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((BodyBristle(need_body(chain, self.place), self.torque_Nm, self.stiffness_Nm_rad),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, BodyBristle) or value.damping or value.extra:
            return None
        return cls(place=chain.bodies[value.body].place, torque_Nm=value.level, stiffness_Nm_rad=value.stiffness)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return bristles(self.torque_Nm, self.stiffness_Nm_rad, scales.travel)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        f = 0.1 * scales.torque
        return [
            {"torque_Nm": f, "stiffness_Nm_rad": f / (0.02 * scales.travel)},
            {"torque_Nm": f, "stiffness_Nm_rad": f / (0.002 * scales.travel)},
        ]
