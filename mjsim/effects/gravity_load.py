"""Gravity: the arm's weight about its axis.

tau = m g l sin(angle_a + phase), pulling the arm back
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.base import Effect, NotApplicableError, Scales, need_body, parameter
from mjsim.effects.law import ANGLE, law
from mjsim.effects.native import Native, Value, Weight
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Motion, Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["GravityLoad"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-m g l sin(angle + phase)."""
    out[0] = -p[0] * math.sin(z[ANGLE] + p[1])


@register
@dataclass(frozen=True, kw_only=True)
class GravityLoad(Effect):
    """Gravity; law, convention and source as in the module's text."""

    id: ClassVar[str] = "gravity_load"
    places: ClassVar[tuple[str, ...]] = ("arm",)
    sentence: ClassVar[str] = (
        "A weight acts on the {place}: {torque_Nm} times the sine of its angle (an unbalanced arm or a tilted axis)."
    )
    citation: ClassVar[str] = "Siciliano, Sciavicco, Villani, Oriolo, Robotics (2009) ch. 7"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm",)
    family: ClassVar[str] = "offset"
    refines: ClassVar[tuple[str, ...]] = ("torque_offset",)

    torque_Nm: float = parameter(Quantity.TORQUE, "largest torque of the weight, link side", lower=0.0)
    phase_rad: float = parameter(Quantity.PHASE, "arm angle from the stable hanging pose at angle zero", nuisance=True)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts: a turning body; the weight of a slide is a constant, a torque offset."""
        if chain.motion is Motion.SLIDE:
            raise NotApplicableError("the weight of a slide does not depend on its position: use torque_offset")
        return (BodyTorque(need_body(chain, self.place), torque, (self.torque_Nm, self.phase_rad), load=True),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((Weight(need_body(chain, self.place), self.torque_Nm, self.phase_rad),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        return cls(torque_Nm=value.torque, phase_rad=value.phase) if isinstance(value, Weight) else None

    def with_load(self, factor: float) -> Self:
        """The weight grows with the load that hangs on the body."""
        return self.with_values({"torque_Nm": factor * self.torque_Nm})

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"torque_Nm": 0.1 * scales.torque, "phase_rad": 0.0}]
