"""Quadratic (drag) friction.

tau_f = c v |v|
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import RATE, law
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain
    from mjsim.mjcf import MjcfEditor

__all__ = ["QuadraticFriction"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-c v |v|."""
    out[0] = -p[0] * z[RATE] * abs(z[RATE])


@register
@dataclass(frozen=True, kw_only=True)
class QuadraticFriction(Effect):
    """Quadratic; law, convention and source as in the module's text."""

    id: ClassVar[str] = "quadratic_friction"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Friction at the {place} that grows with the square of the speed (coefficient {coefficient_Nm_s2_rad2}), as churning or windage does."
    )
    citation: ClassVar[str] = "Swevers, Verdonck, De Schutter, IEEE Control Systems 27 (2007) 58"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("coefficient_Nm_s2_rad2",)
    family: ClassVar[str] = "speed"

    coefficient_Nm_s2_rad2: float = parameter(Quantity.QUADRATIC_DAMPING, "torque over speed squared", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (BodyTorque(need_body(chain, self.place), torque, (self.coefficient_Nm_s2_rad2,)),)

    def native(self, editor: MjcfEditor) -> str | None:
        """MJCF's own elements, or what plain MuJoCo lacks."""
        if editor.drag(need_body(editor.chain, self.place), self.coefficient_Nm_s2_rad2):
            return None
        return f"quadratic friction at the {self.place}: its angle is not one joint's"

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"coefficient_Nm_s2_rad2": 0.05 * scales.torque / scales.velocity**2}]
