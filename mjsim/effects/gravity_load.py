"""Gravity: the arm's weight about its axis.

tau = m g l sin(angle_a + phase), pulling the arm back
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.base import Effect, NotApplicableError, Scales, need_body, parameter
from mjsim.effects.law import ANGLE, law
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Motion, Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain
    from mjsim.mjcf import MjcfEditor

__all__ = ["GravityLoad"]

TURNED = 1e-3  # [rad] by which a weight may hang otherwise than in the file without a word


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-m g l sin(angle + phase)."""
    out[0] = -p[0] * math.sin(z[ANGLE] + p[1])


@register
@dataclass(frozen=True, kw_only=True)
class GravityLoad(Effect):
    """Gravity; law, convention and source as in the module's text."""

    id: ClassVar[str] = "gravity_load"
    places: ClassVar[tuple[str, ...]] = ("arm",)
    sentence: ClassVar[str] = (
        "A weight acts on the {place}: {torque_Nm} times the sine of its angle (an unbalanced arm or a tilted axis)."
    )
    citation: ClassVar[str] = "Siciliano, Sciavicco, Villani, Oriolo, Robotics (2009) ch. 7"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm",)
    family: ClassVar[str] = "offset"
    refines: ClassVar[tuple[str, ...]] = ("torque_offset",)

    torque_Nm: float = parameter(Quantity.TORQUE, "largest torque of the weight, link side", lower=0.0)
    phase_rad: float = parameter(Quantity.PHASE, "arm angle from the stable hanging pose at angle zero", nuisance=True)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts: a turning body; the weight of a slide is a constant, a torque offset."""
        if chain.motion is Motion.SLIDE:
            raise NotApplicableError("the weight of a slide does not depend on its position: use torque_offset")
        return (BodyTorque(need_body(chain, self.place), torque, (self.torque_Nm, self.phase_rad)),)

    def native(self, editor: MjcfEditor) -> str | None:
        """MJCF's own elements, or what plain MuJoCo lacks: the weight of a body that has one in the file is changed."""
        own = editor.holds.get(self.key)
        if own is None:
            return "gravity load at the arm: MJCF has no element for it where no body of the file has a weight"
        editor.weight(self.torque_Nm / own.values["torque_Nm"])
        turned = math.remainder(self.phase_rad - own.values["phase_rad"], 2 * math.pi)
        return f"the angle at which the weight hangs, off by {turned:.3g} rad" if abs(turned) > TURNED else None

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"torque_Nm": 0.1 * scales.torque, "phase_rad": 0.0}]
