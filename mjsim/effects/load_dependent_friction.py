"""Load-dependent friction: a level in proportion to the torque that the mesh transmits.

tau_f = c |T| sign(v), T the transmitted torque: that of the coupling at the body, on the body's own side; on an axis of one rigid
body that of the drive through its gear, ahead of friction, integral action included
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range, load_share
from mjsim.effects.base import Effect, Scales, need_body, need_drive, parameter
from mjsim.effects.law import LOAD, law
from mjsim.effects.ports import Friction, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["LoadDependentFriction"]


@law
def level(z: Any, p: Any, out: Any) -> None:
    """C |T| at rest and in motion."""
    out[0] = p[0] * abs(z[LOAD])
    out[1] = out[0]


@register
@dataclass(frozen=True, kw_only=True)
class LoadDependentFriction(Effect):
    """Load-dependent friction; law, convention and source as in the module's text."""

    id: ClassVar[str] = "load_dependent_friction"
    places: ClassVar[tuple[str, ...]] = ("motor", "gearbox")
    sentence: ClassVar[str] = (
        "Friction at the {place} that grows with the transmitted torque ({coefficient} of it), as in a loaded gear mesh."
    )
    citation: ClassVar[str] = "Bittencourt, Gunnarsson, Robotics and Computer-Integrated Manufacturing 28 (2012) 3"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("coefficient",)
    family: ClassVar[str] = "friction"
    by_load: ClassVar[bool] = True

    coefficient: float = parameter(Quantity.RATIO, "friction torque over transmitted torque", lower=0.0, upper=1.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        if not chain.couplings:
            need_drive(chain)
        return (Friction(need_body(chain, self.place), level, (self.coefficient,)),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a gear may have of it: a mesh of spur gears transmits 98 to 99 % of the power."""
        return (load_share(self.coefficient),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"coefficient": 0.03}, {"coefficient": 0.15}]
