"""Stribeck friction: the level falls from a static to a Coulomb value as the speed grows.

tau_f = (F + F_s exp(-(v/v_s)^2)) sign(v);  it holds up to F + F_s at rest
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import FADED, RATE, law
from mjsim.effects.native import DryFriction, Native
from mjsim.effects.ports import Friction, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["StribeckFriction"]


@law
def level(z: Any, p: Any, out: Any) -> None:
    """F + F_s exp(-(v/v_s)^2); at rest F + F_s."""
    x = z[RATE] / p[2]
    out[0] = p[0] + p[1] * math.exp(-min(x * x, FADED))
    out[1] = p[0] + p[1]


@register
@dataclass(frozen=True, kw_only=True)
class StribeckFriction(Effect):
    """Stribeck friction; law, convention and source as in the module's text."""

    id: ClassVar[str] = "stribeck_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Stribeck friction at the {place}: {torque_Nm} at speed, {extra_static_torque_Nm} more near standstill, fading over {stribeck_velocity_rad_s}."
    )
    citation: ClassVar[str] = "R. Stribeck 1902; Bo and Pavelescu, Wear 82 (1982) 277"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "extra_static_torque_Nm")
    rough: ClassVar[bool] = True
    family: ClassVar[str] = "friction"
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction",)

    torque_Nm: float = parameter(Quantity.TORQUE, "Coulomb level at high speed", lower=0.0)
    extra_static_torque_Nm: float = parameter(Quantity.TORQUE, "level at standstill above the Coulomb level", lower=0.0)
    stribeck_velocity_rad_s: float = parameter(Quantity.VELOCITY, "speed at which the extra level has fallen to 1/e", lower=1e-9)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (self.torque_Nm, self.extra_static_torque_Nm, self.stribeck_velocity_rad_s)
        return (Friction(need_body(chain, self.place), level, p),)

    def limits(self) -> tuple[Effect, ...]:
        """Static friction, as the speed over which the extra level fades goes to zero."""
        from mjsim.effects.static_friction import StaticFriction

        if self.torque_Nm <= 0.0:
            return ()
        peak = 1.0 + self.extra_static_torque_Nm / self.torque_Nm
        return (StaticFriction(place=self.place, torque_Nm=self.torque_Nm, peak=peak),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        level = DryFriction(need_body(chain, self.place), self.torque_Nm)
        return Native((level,), "the higher friction at low speed: frictionloss has the level at high speed only")

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (
            Range("Stribeck velocity", self.stribeck_velocity_rad_s, 0.0, scales.max_velocity, "the speeds that were reached"),
        )

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        f = 0.1 * scales.torque
        return [
            {"torque_Nm": f, "extra_static_torque_Nm": f, "stribeck_velocity_rad_s": 0.05 * scales.velocity},
            {"torque_Nm": f, "extra_static_torque_Nm": f, "stribeck_velocity_rad_s": 0.3 * scales.velocity},
        ]
