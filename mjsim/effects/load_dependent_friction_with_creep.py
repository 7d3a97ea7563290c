"""Friction with a constant part and a part in proportion to the transmitted torque, which fades in with the speed.

tau_f = (F + c |T|) tanh(v / v_c), T as of load-dependent friction
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range, load_share
from mjsim.effects.base import Effect, Scales, need_body, need_drive, parameter
from mjsim.effects.law import LOAD, RATE, law
from mjsim.effects.native import DryFriction, Native
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["LoadDependentFrictionWithCreep"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-(F + c |T|) tanh(v / v_c)."""
    out[0] = -(p[0] + p[1] * abs(z[LOAD])) * math.tanh(z[RATE] / p[2])


@register
@dataclass(frozen=True, kw_only=True)
class LoadDependentFrictionWithCreep(Effect):
    """Load-dependent friction that fades in; law, convention and source as in the module's text."""

    id: ClassVar[str] = "load_dependent_friction_with_creep"
    form_of: ClassVar[str] = "load_dependent_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Friction at the {place} of {torque_Nm} and {coefficient} of the transmitted torque, as in a loaded gear mesh, that fades "
        "in over {creep_velocity_rad_s}: near standstill it lets the {place} creep."
    )
    citation: ClassVar[str] = (
        "Bittencourt, Gunnarsson, Robotics and Computer-Integrated Manufacturing 28 (2012) 3; Andersson, Tribology Int. 40 (2007) 580"
    )
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "coefficient")
    sizes: ClassVar[tuple[str, ...] | None] = ("coefficient",)
    family: ClassVar[str] = "friction"
    multistart: ClassVar[int] = 2
    rigid: ClassVar[bool] = True
    by_load: ClassVar[bool] = True
    # those that come close to it: found first, they must not keep it from being tried
    refines: ClassVar[tuple[str, ...]] = (
        "presliding_friction", "position_dependent_friction", "coulomb_friction_with_creep", "coulomb_friction",
        "load_dependent_friction", "load_dependent_friction_with_constant_part",
    )  # fmt: skip

    torque_Nm: float = parameter(Quantity.TORQUE, "part of the level that does not depend on the load", lower=0.0)
    coefficient: float = parameter(Quantity.RATIO, "friction torque over transmitted torque", lower=0.0, upper=1.0)
    creep_velocity_rad_s: float = parameter(Quantity.VELOCITY, "speed at which 76 % of the level is reached", lower=1e-9)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        if not chain.couplings:
            need_drive(chain)
        return (BodyTorque(need_body(chain, self.place), torque, (self.torque_Nm, self.coefficient, self.creep_velocity_rad_s)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        level = DryFriction(need_body(chain, self.place), self.torque_Nm)
        return Native((level,), f"the part of the friction at the {self.place} that grows with the load, and how it fades in")

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it, and what a gear may have."""
        creep = Range("creep velocity", self.creep_velocity_rad_s, 0.0, scales.max_velocity, "the speeds that were reached")
        return creep, load_share(self.coefficient)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [
            {"torque_Nm": 0.05 * scales.torque, "coefficient": 0.1, "creep_velocity_rad_s": part * scales.velocity}
            for part in (0.03, 0.2)
        ]
