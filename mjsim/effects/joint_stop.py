"""Joint stop: the driven joint runs against a soft stop at either end of its range, as MuJoCo limits a joint.

f = max(0, m (r / T^2 d - 2 zeta v / T - a)) past a stop by r > 0, with v and a away from it;   m = J d / (1 - d)

d(r) is the impedance of MuJoCo's default solimplimit: .9 at the stop, .95 from 1 mrad [mm] on.
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
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["JointStop"]

NARROWEST = 1e-6  # [rad | m], between stops that a fit has moved past each other


@register
@dataclass(frozen=True, kw_only=True)
class JointStop(Effect):
    """Joint stop; law, convention and source as in the module's text."""

    id: ClassVar[str] = "joint_stop"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "The {place} runs against stops at {lower_rad} and {upper_rad}, which push it back within {time_constant_s} "
        "(damping ratio {damping_ratio})."
    )
    citation: ClassVar[str] = "Todorov, Erez, Tassa, MuJoCo (2012); MuJoCo documentation, Solver parameters"
    tolerance: ClassVar[float] = 5e-3
    family: ClassVar[str] = "stop"
    multistart: ClassVar[int] = 3
    rough: ClassVar[bool] = True

    lower_rad: float = parameter(Quantity.ANGLE, "angle of the lower stop")
    upper_rad: float = parameter(Quantity.ANGLE, "angle of the upper stop")
    time_constant_s: float = parameter(Quantity.TIME, "inverse of the undamped frequency at the stop", lower=1e-5)
    damping_ratio: float = parameter(Quantity.RATIO, "damping at the stop over the critical one", lower=0.0)

    @property
    def limit(self) -> Limit:
        """The limits of the joint that it stands for."""
        rate = 1.0 / self.time_constant_s
        low, high = sorted((self.lower_rad, self.upper_rad))
        return Limit(low, max(high, low + NARROWEST), rate * rate, 2.0 * self.damping_ratio * rate)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (JointLimit(self.limit),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((JointRange(self.limit),))

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return (
            Range("time constant in s", self.time_constant_s, 0.1 * scales.dt, scales.duration, "the sampling and the length"),
        )

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit: where the motion turned back, as abruptly as it did; none where it did so at no end.

        Where it did so at one end, the other stop starts out of reach.
        """
        if scales.stops is None:
            ends = [(-1, -0.15 * scales.travel, 0.02), (1, 0.15 * scales.travel, 0.02)]
        else:
            ends = list(scales.stops)
        if not ends:
            return []
        at = {side: angle for side, angle, _ in ends}
        low, high = at.get(-1, at.get(1, 0.0) - 2.0 * scales.travel), at.get(1, at.get(-1, 0.0) + 2.0 * scales.travel)
        longest = max(time for _, _, time in ends)
        return [
            {"lower_rad": low, "upper_rad": high, "time_constant_s": part * longest, "damping_ratio": damping}
            for part in (1.0, 0.3)
            for damping in (1.0, 0.2)
        ]
