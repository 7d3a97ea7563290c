"""Coulomb friction: a constant torque against the motion, a hold at rest.

tau_f = F sign(v),  |tau_f| <= F at v = 0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.base import Effect, NotApplicableError, Scales, need_body, parameter
from mjsim.effects.law import law
from mjsim.effects.native import DryFriction, Native, Value
from mjsim.effects.ports import Friction, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["CoulombFriction"]


@law
def level(z: Any, p: Any, out: Any) -> None:
    """F in both directions, at rest and in motion."""
    out[0] = p[0]
    out[1] = p[0]


@register
@dataclass(frozen=True, kw_only=True)
class CoulombFriction(Effect):
    """Coulomb friction; law, convention and source as in the module's text."""

    id: ClassVar[str] = "coulomb_friction"
    places: ClassVar[tuple[str, ...]] = ("motor", "gearbox", "arm")
    sentence: ClassVar[str] = (
        "Dry (Coulomb) friction of {torque_Nm} at the {place}: a constant torque against the motion that also holds it at rest."
    )
    citation: ClassVar[str] = "C. A. Coulomb 1785; Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    tolerance: ClassVar[float] = 2e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm",)
    family: ClassVar[str] = "friction"

    torque_Nm: float = parameter(Quantity.TORQUE, "level of the friction torque, the same in both directions", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        body = need_body(chain, self.place)
        if self.place != "motor" and body == 0:
            raise NotApplicableError("a rigid axis has one body: its friction stands at the motor")
        return (Friction(body, level, (self.torque_Nm,)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((DryFriction(need_body(chain, self.place), self.torque_Nm),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, DryFriction):
            return None
        return cls(place=chain.bodies[value.body].place, torque_Nm=value.level)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"torque_Nm": 0.05 * scales.torque}, {"torque_Nm": 0.25 * scales.torque}]
