"""Hardening stiffness: a cubic spring beside the linear one.

T = k d + k3 d^3 + damping d'
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.base import Effect, Scales, need_coupling, parameter
from mjsim.effects.law import POSITION, law
from mjsim.effects.native import CubicSpring, Native, Value
from mjsim.effects.ports import CouplingTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["HardeningStiffness"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """k3 d^3."""
    out[0] = p[0] * z[POSITION] * z[POSITION] * z[POSITION]


@register
@dataclass(frozen=True, kw_only=True)
class HardeningStiffness(Effect):
    """Hardening stiffness; law, convention and source as in the module's text."""

    id: ClassVar[str] = "hardening_stiffness"
    places: ClassVar[tuple[str, ...]] = ("gearbox", "arm")
    sentence: ClassVar[str] = (
        "The {place} stiffens with its wind-up: a cubic stiffness of {coefficient_Nm_rad3}, as in a harmonic drive or an angular-contact bearing."
    )
    citation: ClassVar[str] = "Tuttle, Seering, IEEE Trans. Robotics and Automation 12 (1996) 368"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("coefficient_Nm_rad3",)
    family: ClassVar[str] = "coupling"
    multistart: ClassVar[int] = 3

    coefficient_Nm_rad3: float = parameter(Quantity.CUBIC_STIFFNESS, "cubic stiffness, link side; negative softens")

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (CouplingTorque(need_coupling(chain, self.place), torque, (self.coefficient_Nm_rad3,)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((CubicSpring(need_coupling(chain, self.place), self.coefficient_Nm_rad3),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, CubicSpring):
            return None
        return cls(place=chain.couplings[value.coupling].place, coefficient_Nm_rad3=value.coefficient)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"coefficient_Nm_rad3": c * scales.stiffness / scales.deflection**2} for c in (0.05, 0.5, -0.02)]
