"""What the scales of a recording allow the numbers of an effect to be.

A number beyond them is no finding of an engineer: a wave longer than the travel, bristles that never slide, a drift that is over
within one move. Each effect declares such ranges (`Effect.admissible`); they are checked once, before an effect is named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

from mjsim.effects.scales import Scales

__all__ = ["Range", "bristles", "load_share", "mode", "ringing", "servo_stiffness", "wait", "wave"]

WHOLE = 0.03  # relative distance to a whole order of the motor's turn within which an order is that one
BETWEEN = 0.25  # of a sample, within which the delay of an input is that of how it goes between samples: held, linear or a mean
LOSS = 0.01  # of the torque, in a mesh of the best spur gears: G. Niemann, H. Winter, Maschinenelemente II (2003), ch. 21
PEAK = 3.0  # largest over rms of an error of a servo
WARMS_UP = 10.0  # ratio of the friction of a cold and a warm machine: viscosity of grease over some 40 K


def servo_stiffness(scales: Scales) -> float:
    """Force that the servo asks for over its error [N m/rad | N/m]: its kp as fitted, or about that by the recording."""
    if scales.servo > 0:
        return scales.servo
    force = scales.asked[0] if scales.asked else scales.max_torque
    return force / (PEAK * (scales.following or 0.01 * scales.travel))


@final
@dataclass(frozen=True)
class Range:
    """A quantity of an effect, in words, its value and the range [low, high] that the recording allows, and why, in words.

    timing: whether it is a time that below ``low`` is a matter of how the log is sampled.
    """

    what: str
    value: float
    low: float
    high: float
    why: str
    timing: bool = False

    @property
    def holds(self) -> bool:
        """Whether the value is in the range, to 1 %."""
        return self.low * 0.99 <= self.value <= self.high * 1.01

    @property
    def is_below(self) -> bool:
        """Whether it is a time too short to be shown."""
        return self.timing and not self.holds and self.value < self.low


def wave(cycles: float, scales: Scales) -> tuple[Range, ...]:
    """Of ``cycles`` [1/rev | rad/m] over the angle: a whole period within the travel, and two samples a period at the usual speed.

    Half a period is enough for a whole order of the motor's turn, which what is fixed to the motor is likely to have.
    """
    whole = any(abs(cycles / turn - 1.0) < WHOLE for turn in scales.turns)
    least = (math.pi if whole else 2.0 * math.pi) / max(scales.travel, 1e-300)
    most = math.pi / (scales.dt * max(scales.velocity, 1e-300))
    return (Range("spatial frequency", cycles, least, max(most, least), "which the travel and the sampling show"),)


def load_share(coefficient: float) -> Range:
    """Of friction over the torque that a gear transmits: from what the best gears lose to self-locking."""
    return Range("coefficient", coefficient, LOSS, 1.0, "from what the best gears lose to self-locking")


def bristles(torque: float, stiffness: float, way: float) -> tuple[Range, ...]:
    """Of bristles that yield at a torque: they slide both ways within a ``way`` [rad | m]."""
    bend = torque / stiffness if stiffness > 0 else math.inf
    return (Range("deflection at which it slides", bend, 0.0, 0.5 * way, "half the way that was moved"),)


def mode(inertia: float, stiffness: float, scales: Scales) -> tuple[Range, ...]:
    """Of a spring before an inertia: a frequency [rad/s] that the recording is long enough to show, and in the band that is
    compared."""
    frequency = math.sqrt(stiffness / inertia) if inertia > 0 else math.inf
    low, high = 2.0 * math.pi / scales.duration, min(math.pi / scales.dt, 2.0 * math.pi * scales.band)
    why = "one period in the recording to two samples a period, or the end of the band that is compared"
    return (Range("frequency in rad/s", frequency, low, high, why),)


def ringing(inertia: float, stiffness: float, damping: float) -> tuple[Range, ...]:
    """Of an inertia on a spring: damping below the critical, c < 2 sqrt(k m), beyond which it does not oscillate."""
    critical = 2.0 * math.sqrt(max(stiffness * inertia, 0.0))
    ratio = damping / critical if critical > 0 else math.inf
    return (
        Range(
            "damping ratio", ratio, -math.inf, 1.0, "beyond which nothing oscillates, and friction that gives way does as much"
        ),
    )


def wait(what: str, time: float, most: float, why: str, scales: Scales) -> tuple[Range, ...]:
    """Of a delay or a lag [s], up to a time that a reason gives: longer than what an input that nobody states leaves open."""
    least = 0.0 if scales.hold_stated else BETWEEN * scales.dt
    open_ = "" if scales.hold_stated else ", from a quarter of a sample on: nobody states how the input goes between samples"
    return (Range(what, time, least, max(most, least), f"{why}{open_}", timing=True),)
