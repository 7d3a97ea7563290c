"""What the effects of stops share: their limits from their numbers, and starts of a fit where a motion was turned back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mjsim.chain import Limit
from mjsim.effects.admissible import Range
from mjsim.effects.scales import Scales

__all__ = ["FAR", "ends_of", "limit_at", "softness_starts", "time_range"]

FAR = 1e3  # [rad | m], of an end without a stop: no recording gets there
NARROWEST = 1e-6  # [rad | m], between stops that a fit has moved past each other


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


def time_range(time_constant: float, scales: Scales) -> tuple[Range, ...]:
    """What a recording shows of a stop."""
    return (Range("time constant in s", time_constant, 0.1 * scales.dt, scales.duration, "the sampling and the length"),)
