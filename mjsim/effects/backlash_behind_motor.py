"""Backlash between a motor and its link on an axis that the model takes for one rigid body.

J -> J - J_l at the motor, joined to the link J_l by a contact k, damping with a gap b; the weight hangs on the link

T = 0 for |d| < b/2, else k (d -+ b/2) + damping d',  d = q_motor - q_link, and 0 where that would pull
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.extra_flexible_mode import ExtraFlexibleMode
from mjsim.effects.native import LooseLink, Native
from mjsim.effects.ports import BacklashLaw, Gap, Port, SplitInertia
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["BacklashBehindMotor"]


PARTS = (0.75, 0.35)  # of the inertia, behind the gap
GAPS = (0.002, 0.006, 0.02, 0.06)  # of the travel
CONTACT = 0.5  # angle [rad] by which the contact, on the link's inertia, turns in a sample
LOSS = 0.3  # damping of it, of the critical


@register
@dataclass(frozen=True, kw_only=True)
class BacklashBehindMotor(Effect):
    """Backlash behind a motor; law, convention and source as in the module's text."""

    id: ClassVar[str] = "backlash_behind_motor"
    called: ClassVar[str] = "backlash"
    places: ClassVar[tuple[str, ...]] = ("arm",)
    sentence: ClassVar[str] = (
        "Backlash between motor and {place}: a gap of {gap_rad} (total) in which no torque is transmitted; {inertia_kgm2} of the inertia "
        "stands behind it."
    )
    citation: ClassVar[str] = (
        "M. Otter, Modelica.Mechanics.Rotational.ElastoBacklash (2007); Nordin, Gutman, Automatica 38 (2002) 1633"
    )
    tolerance: ClassVar[float] = 1e-3
    sizes: ClassVar[tuple[str, ...] | None] = ("gap_rad", "inertia_kgm2")
    rough: ClassVar[bool] = True
    rigid: ClassVar[bool] = True
    family: ClassVar[str] = "structure"
    multistart: ClassVar[int] = 3

    gap_rad: float = parameter(Quantity.ANGLE, "total gap", lower=0.0)
    inertia_kgm2: float = parameter(Quantity.INERTIA, "inertia of the link, behind the gap", lower=1e-12)
    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "stiffness of the contact", lower=1e-12)
    damping_Nms_rad: float = parameter(Quantity.DAMPING, "damping of the contact", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        split = SplitInertia(
            need_body(chain, self.place), self.inertia_kgm2, self.stiffness_Nm_rad, self.damping_Nms_rad, loaded=True
        )
        return split, Gap(len(chain.couplings), self.gap_rad, BacklashLaw.NO_PULL)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it: on a rigid chain, whose one joint is the motor's."""
        if chain.couplings:
            return super().native(chain)
        return Native((LooseLink(0, self.inertia_kgm2, self.gap_rad, self.stiffness_Nm_rad, self.damping_Nms_rad),))

    def limits(self) -> tuple[Effect, ...]:
        """Without a gap it is a flexible mode."""
        values = {k: v for k, v in self.values.items() if k != "gap_rad"}
        return (ExtraFlexibleMode(place=self.place, **values),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (Range("gap", self.gap_rad, 0.0, scales.travel, "the travel"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: a contact as stiff as the sampling shows, on gaps of parts of the travel."""
        out = []
        for part in PARTS:
            inertia, rate = part * scales.inertia, CONTACT / scales.dt
            contact = {"stiffness_Nm_rad": inertia * rate**2, "damping_Nms_rad": 2.0 * LOSS * inertia * rate}
            out += [{"gap_rad": gap * scales.travel, "inertia_kgm2": inertia, **contact} for gap in GAPS]
        return out
