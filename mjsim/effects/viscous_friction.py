"""Viscous friction of a body behind the motor against the ground, where the nominal model has none.

tau_f = f v

Where the nominal model has it, it is one of its linear parameters, and another value of it is no missing physics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.base import Effect, NotApplicableError, Scales, need_body, parameter
from mjsim.effects.law import RATE, law
from mjsim.effects.native import Native, ViscousDamping
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["ViscousFriction"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-f v."""
    out[0] = -p[0] * z[RATE]


@register
@dataclass(frozen=True, kw_only=True)
class ViscousFriction(Effect):
    """Viscous; law, convention and source as in the module's text."""

    id: ClassVar[str] = "viscous_friction"
    places: ClassVar[tuple[str, ...]] = ("gearbox", "arm")
    sentence: ClassVar[str] = (
        "Viscous friction of {coefficient_Nms_rad} at the {place} against its bearings, where the simulation has none: a torque "
        "against the motion in proportion to the speed."
    )
    citation: ClassVar[str] = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("coefficient_Nms_rad",)
    family: ClassVar[str] = "speed"

    coefficient_Nms_rad: float = parameter(Quantity.DAMPING, "torque over speed", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        body = need_body(chain, self.place)
        if body == 0 or chain.bodies[body].viscous != 0:
            raise NotApplicableError("the nominal model has viscous friction there: it is a linear parameter")
        return (BodyTorque(body, torque, (self.coefficient_Nms_rad,)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((ViscousDamping(need_body(chain, self.place), self.coefficient_Nms_rad),))

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"coefficient_Nms_rad": 0.05 * scales.torque / scales.velocity}]
