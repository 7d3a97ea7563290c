"""Stribeck friction that acts as a damped spring near rest (the LuGre model).

tau_f = s z + d z',  z' = v - s |v| z / (F + F_s exp(-(v/v_s)^2))
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.admissible import Range, bristles
from mjsim.effects.base import Effect, Scales, bristle_stiffnesses, need_body, parameter
from mjsim.effects.law import FADED, RATE, STATE, law
from mjsim.effects.native import BodyBristle, Native, Value
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["StribeckFrictionWithBristles"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-s z - d z'; alpha = v, beta = s |v| / (F + F_s exp(-(v/v_s)^2))."""
    x = z[RATE] / p[2]
    out[1] = z[RATE]
    out[2] = p[3] * abs(z[RATE]) / (p[0] + p[1] * math.exp(-min(x * x, FADED)))
    out[0] = -p[3] * z[STATE] - p[4] * (out[1] - out[2] * z[STATE])


@register
@dataclass(frozen=True, kw_only=True)
class StribeckFrictionWithBristles(Effect):
    """Stribeck friction with bristles; law, convention and source as in the module's text."""

    id: ClassVar[str] = "stribeck_friction_with_bristles"
    form_of: ClassVar[str] = "stribeck_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Stribeck friction at the {place}: {torque_Nm} at speed, {extra_static_torque_Nm} more near standstill, fading over "
        "{stribeck_velocity_rad_s}; before it slides it acts as a spring of {stiffness_Nm_rad}, damped by {damping_Nms_rad} (LuGre)."
    )
    citation: ClassVar[str] = "Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 40 (1995) 419"
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "extra_static_torque_Nm", "stiffness_Nm_rad", "damping_Nms_rad")
    sizes: ClassVar[tuple[str, ...] | None] = ("torque_Nm", "extra_static_torque_Nm", "stiffness_Nm_rad")
    family: ClassVar[str] = "friction"
    multistart: ClassVar[int] = 2
    rough: ClassVar[bool] = True
    refines: ClassVar[tuple[str, ...]] = ("stribeck_friction", "presliding_friction", "coulomb_friction")

    torque_Nm: float = parameter(Quantity.TORQUE, "Coulomb level at high speed", lower=1e-12)
    extra_static_torque_Nm: float = parameter(Quantity.TORQUE, "level at standstill above the Coulomb level", lower=0.0)
    stribeck_velocity_rad_s: float = parameter(Quantity.VELOCITY, "speed at which the extra level has fallen to 1/e", lower=1e-9)
    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "stiffness of the contact at rest", lower=0.0)
    damping_Nms_rad: float = parameter(Quantity.DAMPING, "damping of the contact at rest", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (
            self.torque_Nm, self.extra_static_torque_Nm, self.stribeck_velocity_rad_s, self.stiffness_Nm_rad,
            self.damping_Nms_rad,
        )  # fmt: skip
        return (BodyTorque(need_body(chain, self.place), torque, p, state=True),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        levels = (self.torque_Nm, self.stiffness_Nm_rad, self.damping_Nms_rad, self.extra_static_torque_Nm)
        return Native((BodyBristle(need_body(chain, self.place), *levels, self.stribeck_velocity_rad_s),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, BodyBristle) or not value.extra:
            return None
        return cls(
            place=chain.bodies[value.body].place, torque_Nm=value.level, extra_static_torque_Nm=value.extra,
            stribeck_velocity_rad_s=value.speed, stiffness_Nm_rad=value.stiffness, damping_Nms_rad=value.damping,
        )  # fmt: skip

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        fades = Range("Stribeck velocity", self.stribeck_velocity_rad_s, 0.0, scales.max_velocity, "the speeds that were reached")
        return (fades, *bristles(self.torque_Nm, self.stiffness_Nm_rad, scales.travel))

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        f = 0.1 * scales.torque
        return [
            {"torque_Nm": f, "extra_static_torque_Nm": f, "stribeck_velocity_rad_s": 0.05 * scales.velocity,
             "stiffness_Nm_rad": stiffness, "damping_Nms_rad": 0.3 * (stiffness * scales.inertia) ** 0.5}
            for stiffness in bristle_stiffnesses(f, scales)
        ]  # fmt: skip
