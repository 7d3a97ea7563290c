"""Backlash: a gap that transmits nothing (Modelica ElastoBacklash).

T = 0 for |d| < b/2, else k (d -+ b/2) + damping d'
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_coupling, parameter
from mjsim.effects.native import Native, Slack, Value
from mjsim.effects.ports import Gap, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["Backlash"]


@register
@dataclass(frozen=True, kw_only=True)
class Backlash(Effect):
    """Backlash; law, convention and source as in the module's text."""

    id: ClassVar[str] = "backlash"
    places: ClassVar[tuple[str, ...]] = ("gearbox", "arm")
    sentence: ClassVar[str] = "Backlash in the {place}: a gap of {gap_rad} (total, link side) in which no torque is transmitted."
    citation: ClassVar[str] = (
        "M. Otter, Modelica.Mechanics.Rotational.ElastoBacklash (1999); Nordin, Gutman, Automatica 38 (2002) 1633"
    )
    tolerance: ClassVar[float] = 2e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("gap_rad",)
    rough: ClassVar[bool] = True
    family: ClassVar[str] = "coupling"
    multistart: ClassVar[int] = 3

    gap_rad: float = parameter(Quantity.ANGLE, "total gap, link side", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (Gap(need_coupling(chain, self.place), self.gap_rad),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((Slack(need_coupling(chain, self.place), self.gap_rad),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, Slack):
            return None
        return cls(place=chain.couplings[value.coupling].place, gap_rad=value.width)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("gap", self.gap_rad, 0.0, scales.travel, "the travel"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: a gap is not bounded by the twist of the joint, and a body that crosses it freely leaves little."""
        return [{"gap_rad": c * scales.deflection} for c in (0.1, 0.5, 1.5, 3.0, 6.0, 12.0, 24.0, 48.0)]
