"""Joint stop: the driven joint runs against soft stops at both ends of its range, as MuJoCo limits a joint.

f = max(0, m (r / T^2 d - 2 zeta v / T - a)) past a stop by r > 0, with v and a away from it;   m = J d / (1 - d)

d(r) is the impedance of MuJoCo's default solimplimit: .9 at the stop, .95 from 1 mrad [mm] on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.chain import Limit
from mjsim.effects.base import Scales, parameter
from mjsim.effects.registry import register
from mjsim.effects.soft_stop import SoftStop, ends_of, limit_at, softness_starts
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["JointStop"]


@register
@dataclass(frozen=True, kw_only=True)
class JointStop(SoftStop):
    """Joint stop; law, convention and source as in the module's text."""

    id: ClassVar[str] = "joint_stop"
    sentence: ClassVar[str] = (
        "The {place} runs against stops at {lower_rad} and {upper_rad}, which push it back within {time_constant_s} "
        "(damping ratio {damping_ratio})."
    )
    refines: ClassVar[tuple[str, ...]] = ("lower_joint_stop", "upper_joint_stop")

    lower_rad: float = parameter(Quantity.ANGLE, "angle of the lower stop")
    upper_rad: float = parameter(Quantity.ANGLE, "angle of the upper stop")
    time_constant_s: float = parameter(Quantity.TIME, "inverse of the undamped frequency at the stop", lower=1e-5)
    damping_ratio: float = parameter(Quantity.RATIO, "damping at the stop over the critical one", lower=0.0)

    def limit(self, chain: Chain) -> Limit:
        """The limits of the joint that it stands for."""
        return limit_at(self.lower_rad, self.upper_rad, self.time_constant_s, self.damping_ratio)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit, where the motion was turned back at both ends."""
        ends = ends_of(scales)
        if len(ends) < 2:
            return []
        angles = {"lower_rad": ends[-1][0], "upper_rad": ends[1][0]}
        return [{**angles, **s} for s in softness_starts([time for _, time in ends.values()])]
