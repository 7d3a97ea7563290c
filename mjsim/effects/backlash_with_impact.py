"""Backlash whose contact damps by its depth (compliant impact of Hunt and Crossley, in both directions of the gap).

T = 0 for |d| < b/2, else k e (1 + c d' sign e) + damping d',  e = d -+ b/2
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.backlash import Backlash
from mjsim.effects.base import Effect, Scales, need_coupling, parameter
from mjsim.effects.law import POSITION, RATE, law
from mjsim.effects.ports import CouplingTorque, Gap, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["BacklashWithImpact"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """C k |e| d'."""
    out[0] = p[0] * p[1] * abs(z[POSITION]) * z[RATE]


@register
@dataclass(frozen=True, kw_only=True)
class BacklashWithImpact(Effect):
    """Backlash with a compliant impact; law, convention and source as in the module's text."""

    id: ClassVar[str] = "backlash_with_impact"
    form_of: ClassVar[str] = "backlash"
    places: ClassVar[tuple[str, ...]] = ("gearbox", "arm")
    sentence: ClassVar[str] = (
        "Backlash in the {place}: a gap of {gap_rad} (total, link side) in which no torque is transmitted, and a contact that damps the "
        "more the deeper it is, by {impact_s_rad} (compliant impact)."
    )
    citation: ClassVar[str] = "K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440"
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ("gap_rad", "impact_s_rad")
    sizes: ClassVar[tuple[str, ...] | None] = ("gap_rad",)
    rough: ClassVar[bool] = True
    family: ClassVar[str] = "coupling"
    multistart: ClassVar[int] = 3
    refines: ClassVar[tuple[str, ...]] = ("backlash",)

    gap_rad: float = parameter(Quantity.ANGLE, "total gap, link side", lower=0.0)
    impact_s_rad: float = parameter(Quantity.PER_VELOCITY, "damping of the contact over its torque, link side", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        j = need_coupling(chain, self.place)
        return Gap(j, self.gap_rad), CouplingTorque(j, torque, (self.impact_s_rad, chain.couplings[j].stiffness))

    def nearest(self, chain: Chain, speed: float) -> tuple[Chain, tuple[Effect, ...]]:
        """The gap, with the damper of the coupling in place of that of the contact."""
        return chain, (Backlash(place=self.place, gap_rad=self.gap_rad),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("gap", self.gap_rad, 0.0, scales.travel, "the travel"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        rate = scales.deflection * (scales.stiffness / scales.inertia) ** 0.5
        return [
            {"gap_rad": gap * scales.deflection, "impact_s_rad": part / rate} for gap in (0.1, 0.5, 1.5) for part in (0.02, 0.3)
        ]
