"""Asymmetric Coulomb friction: another level for each direction.

tau_f = F sign(v) + A;  F + A resists forward, F - A backward motion
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import DIRECTION, law
from mjsim.effects.native import DriveTorque, DryFriction, Native
from mjsim.effects.ports import Friction, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["AsymmetricFriction"]


@law
def level(z: Any, p: Any, out: Any) -> None:
    """F + A sign(v), not below zero at rest."""
    out[0] = p[0] + p[1] * z[DIRECTION]
    out[1] = out[0]


@register
@dataclass(frozen=True, kw_only=True)
class AsymmetricFriction(Effect):
    """Asymmetric Coulomb friction; law, convention and source as in the module's text."""

    id: ClassVar[str] = "asymmetric_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Dry friction at the {place} that depends on the direction: {torque_Nm} on average, {asymmetry_Nm} more forward and as much less backward."
    )
    citation: ClassVar[str] = "Janot, Gautier, Brunot, Data Set and Reference Models of EMPS (2019)"
    tolerance: ClassVar[float] = 2e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "asymmetry_Nm")
    family: ClassVar[str] = "friction"
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction", "torque_offset")

    torque_Nm: float = parameter(Quantity.TORQUE, "mean of the two levels", lower=0.0)
    asymmetry_Nm: float = parameter(Quantity.TORQUE, "added for v > 0, taken off for v < 0")

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (Friction(need_body(chain, self.place), level, (self.torque_Nm, self.asymmetry_Nm)),)

    def parts(self) -> tuple[Effect, ...]:
        """Coulomb friction and an offset."""
        from mjsim.effects.coulomb_friction import CoulombFriction
        from mjsim.effects.torque_offset import TorqueOffset

        return CoulombFriction(place=self.place, torque_Nm=self.torque_Nm), TorqueOffset(torque_Nm=-self.asymmetry_Nm)

    @classmethod
    def whole(cls, parts: Sequence[Effect]) -> Effect | None:
        """Coulomb friction and an offset at one place."""
        by_id = {e.id: e for e in parts}
        friction, offset = by_id.get("coulomb_friction"), by_id.get("torque_offset")
        if len(parts) != 2 or friction is None or offset is None or friction.place not in cls.places:
            return None
        return cls(place=friction.place, torque_Nm=friction.values["torque_Nm"], asymmetry_Nm=-offset.values["torque_Nm"])

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        # F sign(v) + A, also at rest, is Coulomb friction F beside a constant torque -A
        return Native((DryFriction(need_body(chain, self.place), self.torque_Nm), DriveTorque(-self.asymmetry_Nm)))

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (
            Range("asymmetry", abs(self.asymmetry_Nm), 0.0, self.torque_Nm, "the mean level: friction opposes both directions"),
        )

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        f = 0.1 * scales.torque
        return [{"torque_Nm": f, "asymmetry_Nm": c * f} for c in (0.1, -0.1, 0.7, -0.7)]
