"""Lower joint stop: the driven joint runs against a soft stop at the lower end of its range, as MuJoCo limits a joint.

f = max(0, m (r / T^2 d - 2 zeta v / T - a)) past the stop by r > 0, with v and a away from it;   m = J d / (1 - d)

d(r) is the impedance of MuJoCo's default solimplimit: .9 at the stop, .95 from 1 mrad [mm] on. The upper end is that of the model,
or out of reach.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.chain import Limit
from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, parameter
from mjsim.effects.native import JointRange, Native
from mjsim.effects.ports import JointLimit, Port
from mjsim.effects.registry import register
from mjsim.effects.stop_starts import FAR, ends_of, limit_at, softness_starts, time_range
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["LowerJointStop"]


@register
@dataclass(frozen=True, kw_only=True)
class LowerJointStop(Effect):
    """Lower joint stop; law, convention and source as in the module's text."""

    id: ClassVar[str] = "lower_joint_stop"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "The {place} runs against a stop at {angle_rad}, the lower end of its range, which pushes it back within {time_constant_s} "
        "(damping ratio {damping_ratio})."
    )
    citation: ClassVar[str] = "Todorov, Erez, Tassa, MuJoCo (2012); MuJoCo documentation, Solver parameters"
    tolerance: ClassVar[float] = 5e-3
    family: ClassVar[str] = "stop"
    multistart: ClassVar[int] = 3
    rough: ClassVar[bool] = True

    angle_rad: float = parameter(Quantity.ANGLE, "angle of the stop")
    time_constant_s: float = parameter(Quantity.TIME, "inverse of the undamped frequency at the stop", lower=1e-5)
    damping_ratio: float = parameter(Quantity.RATIO, "damping at the stop over the critical one", lower=0.0)

    def limit(self, chain: Chain) -> Limit:
        """The limits of the joint that it stands for; the upper one as the chain has it."""
        own = chain.bodies[0].limit
        return limit_at(self.angle_rad, FAR if own is None else own.upper, self.time_constant_s, self.damping_ratio)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (JointLimit(self.limit(chain)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((JointRange(self.limit(chain)),))

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return time_range(self.time_constant_s, scales)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit, where the motion was turned back at this end."""
        ends = ends_of(scales)
        if -1 not in ends:
            return []
        angle, time = ends[-1]
        return [{"angle_rad": angle, **s} for s in softness_starts([time])]
