"""Presliding friction whose bristle is damped (the LuGre model without Stribeck effect).

tau_f = s z + d z',  z' = v - s |v| z / F
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.admissible import Range, bristles
from mjsim.effects.base import Effect, Scales, bristle_stiffnesses, need_body, parameter
from mjsim.effects.law import RATE, STATE, law
from mjsim.effects.native import BodyBristle, Native, Value
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["PreslidingFrictionWithDamping"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-s z - d z'; alpha = v, beta = s |v| / F."""
    out[1] = z[RATE]
    out[2] = p[1] * abs(z[RATE]) / p[0]
    out[0] = -p[1] * z[STATE] - p[2] * (out[1] - out[2] * z[STATE])


@register
@dataclass(frozen=True, kw_only=True)
class PreslidingFrictionWithDamping(Effect):
    """Presliding friction with a damped bristle; law, convention and source as in the module's text."""

    id: ClassVar[str] = "presliding_friction_with_damping"
    form_of: ClassVar[str] = "presliding_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Friction at the {place} that acts as a spring of {stiffness_Nm_rad}, damped by {damping_Nms_rad}, before it slides at "
        "{torque_Nm} (presliding, LuGre)."
    )
    citation: ClassVar[str] = "Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 40 (1995) 419"
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "stiffness_Nm_rad", "damping_Nms_rad")
    sizes: ClassVar[tuple[str, ...] | None] = ("torque_Nm", "stiffness_Nm_rad")
    family: ClassVar[str] = "friction"
    multistart: ClassVar[int] = 2
    refines: ClassVar[tuple[str, ...]] = ("presliding_friction", "coulomb_friction")

    torque_Nm: float = parameter(Quantity.TORQUE, "sliding level", lower=1e-12)
    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "stiffness of the contact at rest", lower=0.0)
    damping_Nms_rad: float = parameter(Quantity.DAMPING, "damping of the contact at rest", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (self.torque_Nm, self.stiffness_Nm_rad, self.damping_Nms_rad)
        return (BodyTorque(need_body(chain, self.place), torque, p, state=True),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        body = need_body(chain, self.place)
        return Native((BodyBristle(body, self.torque_Nm, self.stiffness_Nm_rad, self.damping_Nms_rad),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, BodyBristle) or not value.damping or value.extra:
            return None
        place = chain.bodies[value.body].place
        return cls(place=place, torque_Nm=value.level, stiffness_Nm_rad=value.stiffness, damping_Nms_rad=value.damping)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return bristles(self.torque_Nm, self.stiffness_Nm_rad, scales.travel)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        f = 0.1 * scales.torque
        return [
            {"torque_Nm": f, "stiffness_Nm_rad": stiffness, "damping_Nms_rad": part * (stiffness * scales.inertia) ** 0.5}
            for stiffness in bristle_stiffnesses(f, scales) for part in (0.05, 0.5)
        ]  # fmt: skip
