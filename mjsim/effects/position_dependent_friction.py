"""Friction that varies over the motor's turn.

tau_f = F (1 + a sin(n angle + phase)) sign(v)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range, wave
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import ANGLE, law
from mjsim.effects.native import DryFriction, Native
from mjsim.effects.ports import Friction, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["PositionDependentFriction"]


@law
def level(z: Any, p: Any, out: Any) -> None:
    """F (1 + a sin(n angle + phase))."""
    out[0] = p[0] * (1.0 + p[1] * math.sin(p[2] * z[ANGLE] + p[3]))
    out[1] = out[0]


@register
@dataclass(frozen=True, kw_only=True)
class PositionDependentFriction(Effect):
    """Friction that varies over the motor's turn; law, convention and source as in the module's text."""

    id: ClassVar[str] = "position_dependent_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Dry friction at the {place} of {torque_Nm} that varies by {relative_amplitude} of itself, repeating at {cycles_per_rev}."
    )
    citation: ClassVar[str] = "Armstrong-Helouvry, Control of Machines with Friction (1991) ch. 4"
    tolerance: ClassVar[float] = 2e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm",)
    sizes: ClassVar[tuple[str, ...] | None] = ("torque_Nm", "relative_amplitude")
    family: ClassVar[str] = "friction"
    multistart: ClassVar[int] = 3
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction",)

    torque_Nm: float = parameter(Quantity.TORQUE, "mean level", lower=0.0)
    relative_amplitude: float = parameter(Quantity.RATIO, "variation over mean level", lower=0.0, upper=1.0)
    cycles_per_rev: float = parameter(Quantity.CYCLES, "periods per turn of the motor", lower=0.0)
    phase_rad: float = parameter(Quantity.PHASE, "phase at angle zero", nuisance=True)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (self.torque_Nm, self.relative_amplitude, self.cycles_per_rev, self.phase_rad)
        return (Friction(need_body(chain, self.place), level, p),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        level = DryFriction(need_body(chain, self.place), self.torque_Nm)
        return Native((level,), "the variation of friction over the angle: frictionloss has its mean")

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return wave(self.cycles_per_rev, scales)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [
            {"torque_Nm": 0.1 * scales.torque, "relative_amplitude": 0.3, "cycles_per_rev": n, "phase_rad": 0.0}
            for n in dict.fromkeys((*scales.orders[:4], *scales.turns))
        ]
