"""Coulomb friction that fades in with the speed: viscous near standstill, where it lets a body creep instead of holding it.

tau_f = F tanh(v / v_c)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, NotApplicableError, Scales, need_body, parameter
from mjsim.effects.law import RATE, law
from mjsim.effects.native import DryFriction, Native
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["CoulombFrictionWithCreep"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-F tanh(v / v_c)."""
    out[0] = -p[0] * math.tanh(z[RATE] / p[1])


@register
@dataclass(frozen=True, kw_only=True)
class CoulombFrictionWithCreep(Effect):
    """Coulomb friction that fades in; law, convention and source as in the module's text."""

    id: ClassVar[str] = "coulomb_friction_with_creep"
    form_of: ClassVar[str] = "coulomb_friction"
    places: ClassVar[tuple[str, ...]] = ("motor", "gearbox", "arm")
    sentence: ClassVar[str] = (
        "Dry (Coulomb) friction of {torque_Nm} at the {place} that fades in over {creep_velocity_rad_s}: near standstill it lets the "
        "{place} creep."
    )
    citation: ClassVar[str] = (
        "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083; Andersson, Tribology Int. 40 (2007) 580"
    )
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm",)
    family: ClassVar[str] = "friction"
    multistart: ClassVar[int] = 2
    # presliding friction is no part of this law but comes close to it: found first, it must not keep it from being tried
    refines: ClassVar[tuple[str, ...]] = ("presliding_friction", "coulomb_friction")

    torque_Nm: float = parameter(Quantity.TORQUE, "level of the friction torque at speed", lower=0.0)
    creep_velocity_rad_s: float = parameter(Quantity.VELOCITY, "speed at which 76 % of the level is reached", lower=1e-9)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        body = need_body(chain, self.place)
        if self.place != "motor" and body == 0:
            raise NotApplicableError("a rigid axis has one body: its friction stands at the motor")
        return (BodyTorque(body, torque, (self.torque_Nm, self.creep_velocity_rad_s)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        level = DryFriction(need_body(chain, self.place), self.torque_Nm)
        return Native((level,), f"how the friction at the {self.place} fades in: frictionloss holds at rest")

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("creep velocity", self.creep_velocity_rad_s, 0.0, scales.max_velocity, "the speeds that were reached"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"torque_Nm": 0.1 * scales.torque, "creep_velocity_rad_s": part * scales.velocity} for part in (0.03, 0.2)]
