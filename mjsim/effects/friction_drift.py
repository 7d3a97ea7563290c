"""Friction that fades (or grows) as the machine warms up.

tau_f = F (1 + c exp(-t/T)) sign(v)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import WARMS_UP, Range
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import FADED, TIME, law
from mjsim.effects.native import DryFriction, Native
from mjsim.effects.ports import Friction, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["FrictionDrift"]


@law
def level(z: Any, p: Any, out: Any) -> None:
    """F (1 + c exp(-t/T))."""
    out[0] = p[0] * (1.0 + p[1] * math.exp(-min(z[TIME] / p[2], FADED)))
    out[1] = out[0]


@register
@dataclass(frozen=True, kw_only=True)
class FrictionDrift(Effect):
    """Friction that fades; law, convention and source as in the module's text."""

    id: ClassVar[str] = "friction_drift"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Friction at the {place} that drifts as it warms up: {torque_Nm} in the end, changed by {relative_change} of itself at the start, over {time_constant_s}."
    )
    citation: ClassVar[str] = "Simoni, Beschi, Legnani, Visioli, IROS (2015) 3624"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm",)
    sizes: ClassVar[tuple[str, ...] | None] = ("torque_Nm", "relative_change")
    family: ClassVar[str] = "friction"
    refines: ClassVar[tuple[str, ...]] = ("coulomb_friction",)

    torque_Nm: float = parameter(Quantity.TORQUE, "final level", lower=0.0)
    relative_change: float = parameter(Quantity.RATIO, "relative excess at the start of the recording", lower=-1.0)
    time_constant_s: float = parameter(Quantity.TIME, "time constant of the drift", lower=1e-3)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (self.torque_Nm, self.relative_change, self.time_constant_s)
        return (Friction(need_body(chain, self.place), level, p),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        level = DryFriction(need_body(chain, self.place), self.torque_Nm)
        return Native((level,), "the drift of friction: frictionloss has its final level")

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        low, high = max(scales.move, 0.02 * scales.duration), 10.0 * scales.duration
        # from tenfold at the start to a tenth of the final level
        return (
            Range("time constant in s", self.time_constant_s, low, high, "slower than a move, and seen in the recording"),
            Range(
                "level at the start over that in the end",
                1.0 + self.relative_change,
                1.0 / WARMS_UP,
                WARMS_UP,
                "as lubricants warm up",
            ),
        )

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        f = 0.1 * scales.torque
        return [
            {"torque_Nm": f, "relative_change": 0.5, "time_constant_s": 0.3 * scales.duration},
            {"torque_Nm": f, "relative_change": -0.3, "time_constant_s": 0.3 * scales.duration},
            {"torque_Nm": f, "relative_change": 0.5, "time_constant_s": 0.1 * scales.duration},
        ]
