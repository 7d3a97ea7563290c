"""Viscous friction that grows less than in proportion to speed, as greased gears have it.

tau_f = c v (v^2 + V^2)^((n - 1) / 2),    0.1 <= n <= 0.9; V = 1e-3 rad/s (m/s) takes the infinite slope off the origin

Below that range the law is that of Coulomb friction, above it that of viscous friction, as far as a recording tells.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.coulomb_friction import CoulombFriction
from mjsim.effects.law import RATE, law
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["SublinearViscousFriction"]

SMALL = 1e-3  # rad/s | m/s: speed below which the law is a plain damper


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-c v (v^2 + V^2)^((n - 1) / 2)."""
    out[0] = -p[0] * z[RATE] * (z[RATE] * z[RATE] + 1e-6) ** (0.5 * (p[1] - 1.0))


@register
@dataclass(frozen=True, kw_only=True)
class SublinearViscousFriction(Effect):
    """Sublinear viscous friction; law, convention and source as in the module's text."""

    id: ClassVar[str] = "sublinear_viscous_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Friction at the {place} that grows less than in proportion to speed: {coefficient} times the speed to the power {exponent}."
    )
    citation: ClassVar[str] = "Bona, Indri, Proc. 44th IEEE Conf. Decision and Control (2005) 4549"
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ("coefficient",)
    family: ClassVar[str] = "speed"
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction",)

    coefficient: float = parameter(Quantity.TORQUE, "torque at a speed of 1", lower=0.0)
    exponent: float = parameter(Quantity.RATIO, "power of the speed", lower=0.1, upper=0.9)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (BodyTorque(need_body(chain, self.place), torque, (self.coefficient, self.exponent)),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("exponent", self.exponent, 0.11, 0.89, "beyond which it is Coulomb or viscous friction"),)

    def nearest(self, chain: Chain, speed: float) -> tuple[Chain, tuple[Effect, ...]]:
        """Coulomb friction beside damping: the tangent at a speed V, c V^n ((1 - n) + n v / V)."""
        at, v = need_body(chain, self.place), max(speed, SMALL)
        level = self.coefficient * v**self.exponent
        body = chain.bodies[at]
        damped = dataclasses.replace(body, viscous=body.viscous + self.exponent * level / v)
        bodies = (*chain.bodies[:at], damped, *chain.bodies[at + 1 :])
        dry = CoulombFriction(place=self.place, torque_Nm=(1.0 - self.exponent) * level)
        return dataclasses.replace(chain, bodies=bodies), (dry,)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: a twentieth of the torque at the mean speed."""
        return [{"coefficient": 0.05 * scales.torque / scales.velocity**n, "exponent": n} for n in (0.5, 0.7)]
