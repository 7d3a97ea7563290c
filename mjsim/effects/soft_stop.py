"""What the effects of joint stops share: limits from their numbers, and starts of a fit where a motion was turned back."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.chain import Limit
from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales
from mjsim.effects.native import JointRange, Native
from mjsim.effects.ports import JointLimit, Port

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["FAR", "SoftStop", "ends_of", "limit_at", "softness_starts"]

FAR = 1e3  # [rad | m], of an end without a stop: no recording gets there
NARROWEST = 1e-6  # [rad | m], between stops that a fit has moved past each other


@dataclass(frozen=True, kw_only=True)
class SoftStop(Effect):
    """A range of the driven joint, with the parameters ``time_constant_s`` and ``damping_ratio`` beside its ends."""

    places: ClassVar[tuple[str, ...]] = ("motor",)
    citation: ClassVar[str] = "Todorov, Erez, Tassa, MuJoCo (2012); MuJoCo documentation, Solver parameters"
    tolerance: ClassVar[float] = 5e-3
    family: ClassVar[str] = "stop"
    multistart: ClassVar[int] = 3
    rough: ClassVar[bool] = True

    @abc.abstractmethod
    def limit(self, chain: Chain) -> Limit:
        """The limits of the joint that it stands for."""

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (JointLimit(self.limit(chain)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((JointRange(self.limit(chain)),))

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        time = self.values["time_constant_s"]
        return (Range("time constant in s", time, 0.1 * scales.dt, scales.duration, "the sampling and the length"),)


def limit_at(lower: float, upper: float, time_constant: float, damping_ratio: float) -> Limit:
    """Limits at two angles [rad | m], in whichever order, with K = 1 / T^2 and B = 2 zeta / T."""
    rate = 1.0 / time_constant
    low, high = sorted((lower, upper))
    return Limit(low, max(high, low + NARROWEST), rate * rate, 2.0 * damping_ratio * rate)


def ends_of(scales: Scales) -> dict[int, tuple[float, float]]:
    """Angle [rad | m] and time constant [s] of each end (-1, +1) that turned the motion back.

    A guess of both where none was looked for.
    """
    if scales.stops is None:
        return {side: (0.15 * side * scales.travel, 0.02) for side in (-1, 1)}
    return {side: (angle, time) for side, angle, time in scales.stops}


def softness_starts(times: Sequence[float]) -> list[Mapping[str, float]]:
    """Time constants from the longest of some on down, each with two damping ratios."""
    longest = max(times)
    return [{"time_constant_s": part * longest, "damping_ratio": damping} for part in (1.0, 0.3) for damping in (1.0, 0.2)]
