"""Static friction with a peak: the breakaway torque is a multiple of the sliding torque (Modelica BearingFriction).

tau_f = F sign(v) in motion; at rest it holds up to peak * F
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import law
from mjsim.effects.native import DryFriction, Native
from mjsim.effects.ports import Friction, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["StaticFriction"]


@law
def level(z: Any, p: Any, out: Any) -> None:
    """Sliding F, breakaway peak F."""
    out[0] = p[0]
    out[1] = p[0] * p[1]


@register
@dataclass(frozen=True, kw_only=True)
class StaticFriction(Effect):
    """Static friction with a peak; law, convention and source as in the module's text."""

    id: ClassVar[str] = "static_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = "Stiction at the {place}: it slides against {torque_Nm} but breaks away only at {peak} times that."
    citation: ClassVar[str] = "M. Otter, Modelica.Mechanics.Rotational.BearingFriction (1999)"
    tolerance: ClassVar[float] = 2e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm",)
    rough: ClassVar[bool] = True
    family: ClassVar[str] = "friction"
    multistart: ClassVar[int] = 4
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction",)

    torque_Nm: float = parameter(Quantity.TORQUE, "sliding friction torque", lower=0.0)
    peak: float = parameter(Quantity.RATIO, "breakaway torque over sliding torque", lower=1.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (Friction(need_body(chain, self.place), level, (self.torque_Nm, self.peak)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        level = DryFriction(need_body(chain, self.place), self.torque_Nm)
        return Native((level,), "the higher friction at rest: frictionloss has one level")

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        f = 0.1 * scales.torque
        # a breakaway that comes a moment earlier or later: the error has a minimum for each
        return [{"torque_Nm": f, "peak": peak} for peak in (1.25, 1.6, 2.0, 2.5, 3.0, 3.6, 4.3, 5.2)]
