"""Inertia that depends on the angle.

J(q) = J (1 + c sin(n q + phase)),  torque J q'' + J' q'^2 / 2
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import ANGLE, law
from mjsim.effects.ports import BodyInertia, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["PositionDependentInertia"]

MOST = 500.0  # periods of an arm's own turn, above which no inertia varies


@law
def change(z: Any, p: Any, out: Any) -> None:
    """C sin(n q + phase) and its slope."""
    x = p[1] * z[ANGLE] + p[2]
    out[0] = p[0] * math.sin(x)
    out[1] = p[0] * p[1] * math.cos(x)


@register
@dataclass(frozen=True, kw_only=True)
class PositionDependentInertia(Effect):
    """Inertia that depends on the angle; law, convention and source as in the module's text."""

    id: ClassVar[str] = "position_dependent_inertia"
    places: ClassVar[tuple[str, ...]] = ("arm",)
    sentence: ClassVar[str] = (
        "The inertia at the {place} varies by {relative_amplitude} of itself, repeating at {cycles_per_rev} of it (an eccentric or folding load)."
    )
    citation: ClassVar[str] = "Siciliano, Sciavicco, Villani, Oriolo, Robotics (2009) ch. 7"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("relative_amplitude",)
    family: ClassVar[str] = "position"
    multistart: ClassVar[int] = 3

    relative_amplitude: float = parameter(Quantity.RATIO, "variation over mean inertia", lower=0.0, upper=0.95)
    cycles_per_rev: float = parameter(Quantity.CYCLES, "periods per turn of the arm", lower=0.0)
    phase_rad: float = parameter(Quantity.PHASE, "phase at angle zero", nuisance=True)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (self.relative_amplitude, self.cycles_per_rev, self.phase_rad)
        return (BodyInertia(need_body(chain, self.place), change, p),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [
            {"relative_amplitude": 0.2, "cycles_per_rev": n, "phase_rad": 0.0}
            for n in dict.fromkeys((1.0, 2.0, 3.0, 4.0, *scales.orders[:3], *scales.swung))
            if n <= MOST
        ]
