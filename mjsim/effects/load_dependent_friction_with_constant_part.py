"""Friction with a constant part and a part in proportion to the transmitted torque, as gears and bearings have.

tau_f = (F + c |T|) sign(v), T as of load-dependent friction
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range, load_share
from mjsim.effects.base import Effect, Scales, need_body, need_drive, parameter
from mjsim.effects.coulomb_friction import CoulombFriction
from mjsim.effects.law import LOAD, law
from mjsim.effects.load_dependent_friction import LoadDependentFriction
from mjsim.effects.native import DryFriction, Native
from mjsim.effects.ports import Friction, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["LoadDependentFrictionWithConstantPart"]


@law
def level(z: Any, p: Any, out: Any) -> None:
    """F + c |T| at rest and in motion."""
    out[0] = p[0] + p[1] * abs(z[LOAD])
    out[1] = out[0]


@register
@dataclass(frozen=True, kw_only=True)
class LoadDependentFrictionWithConstantPart(Effect):
    """Load-dependent friction beside Coulomb friction; law, convention and source as in the module's text."""

    id: ClassVar[str] = "load_dependent_friction_with_constant_part"
    called: ClassVar[str] = "load_dependent_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Friction at the {place} of {torque_Nm} and {coefficient} of the transmitted torque, as in a loaded gear mesh."
    )
    citation: ClassVar[str] = (
        "Bittencourt, Gunnarsson, Robotics and Computer-Integrated Manufacturing 28 (2012) 3; "
        "Duclusaud, Passault, Padois, Ly, Extended friction models for the physics simulation of servo actuators (2024)"
    )
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "coefficient")
    sizes: ClassVar[tuple[str, ...] | None] = ("torque_Nm", "coefficient")
    family: ClassVar[str] = "friction"
    rigid: ClassVar[bool] = True
    by_load: ClassVar[bool] = True
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction", "load_dependent_friction")

    torque_Nm: float = parameter(Quantity.TORQUE, "part of the level that does not depend on the load", lower=0.0)
    coefficient: float = parameter(
        Quantity.RATIO, "friction torque beyond that part over transmitted torque", lower=0.0, upper=1.0
    )

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        if not chain.couplings:
            need_drive(chain)
        return (Friction(need_body(chain, self.place), level, (self.torque_Nm, self.coefficient)),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a gear may have of it."""
        return (load_share(self.coefficient),)

    def parts(self) -> tuple[Effect, ...]:
        """Both parts as effects of their own."""
        return (
            CoulombFriction(place=self.place, torque_Nm=self.torque_Nm),
            LoadDependentFriction(place=self.place, coefficient=self.coefficient),
        )

    @classmethod
    def whole(cls, parts: Sequence[Effect]) -> Effect | None:
        """Coulomb and load-dependent friction at one place."""
        by_id = {e.id: e for e in parts}
        friction, load = by_id.get(CoulombFriction.id), by_id.get(LoadDependentFriction.id)
        if len(parts) != 2 or friction is None or load is None or {friction.place, load.place} != set(cls.places):
            return None
        return cls(place=friction.place, torque_Nm=friction.values["torque_Nm"], coefficient=load.values["coefficient"])

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        level = DryFriction(need_body(chain, self.place), self.torque_Nm)
        return Native((level,), f"the part of the friction at the {self.place} that grows with the load")

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"torque_Nm": 0.05 * scales.torque, "coefficient": c} for c in (0.03, 0.15)]
