"""Upper joint stop: the driven joint runs against a soft stop at the upper end of its range, as MuJoCo limits a joint.

f = max(0, m (r / T^2 d - 2 zeta v / T - a)) past a stop by r > 0, with v and a away from it;   m = J d / (1 - d)

d(r) is the impedance of MuJoCo's default solimplimit: .9 at the stop, .95 from 1 mrad [mm] on. The lower end is that of the model,
or out of reach.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.chain import Limit
from mjsim.effects.base import Scales, parameter
from mjsim.effects.registry import register
from mjsim.effects.soft_stop import FAR, SoftStop, ends_of, limit_at, softness_starts
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["UpperJointStop"]


@register
@dataclass(frozen=True, kw_only=True)
class UpperJointStop(SoftStop):
    """Upper joint stop; law, convention and source as in the module's text."""

    id: ClassVar[str] = "upper_joint_stop"
    sentence: ClassVar[str] = (
        "The {place} runs against a stop at {angle_rad}, the upper end of its range, which pushes it back within {time_constant_s} "
        "(damping ratio {damping_ratio})."
    )

    angle_rad: float = parameter(Quantity.ANGLE, "angle of the stop")
    time_constant_s: float = parameter(Quantity.TIME, "inverse of the undamped frequency at the stop", lower=1e-5)
    damping_ratio: float = parameter(Quantity.RATIO, "damping at the stop over the critical one", lower=0.0)

    def limit(self, chain: Chain) -> Limit:
        """The limits of the joint that it stands for; the lower one as the chain has it."""
        own = chain.bodies[0].limit
        return limit_at(-FAR if own is None else own.lower, self.angle_rad, self.time_constant_s, self.damping_ratio)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit, where the motion was turned back at this end."""
        ends = ends_of(scales)
        if 1 not in ends:
            return []
        angle, time = ends[1]
        return [{"angle_rad": angle, **s} for s in softness_starts([time])]
