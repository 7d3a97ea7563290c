"""Sizes of a recording at a place: what starts of a fit are multiples of, and what ranges of numbers follow from."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["Scales"]


@dataclass(frozen=True)
class Scales:
    """Typical sizes at a place, from the recording and the nominal model; starts of a fit are multiples of these.

    torque, max_torque: rms and largest input or transmitted torque at the place [N m | N]; velocity, max_velocity: of the
    body at the place [rad/s | m/s]; deflection: rms elastic deflection of the coupling at the place [rad | m] (1 when
    there is none); inertia, stiffness: nominal values at the place; travel: range of the body's angle [rad | m];
    input, max_input: rms and largest input; output: rms measured output; dt, duration [s]; orders: dominant spatial
    frequencies of the residual over the body's angle [1/rev | rad/m]; swung: those at which an inertia that varies over the
    angle would leave it; turns: whole orders of the motor's turn that its travel can
    show, which what is fixed to the motor is likely to have; steps: those in which the measured output comes, where
    its values show any; following: rms error of a position servo, of its actuator [rad | m]; asked: levels of the force that
    the input, or a servo's law without its limit, asks of the actuator [N m | N]: the largest, and those exceeded in a tenth
    and in three tenths of the time; move: mean time between reversals of the velocity [s],
    the duration where it does not reverse; stops: (side, angle [rad | m], time constant [s]) of each end of the travel at which the
    motion is turned back as at a stop, side -1 or +1; None where this was not looked for; hold_stated: whether it is known how
    the input goes between samples; band: highest frequency [Hz] that is compared; acceleration: largest of the body at the place
    [rad/s^2 | m/s^2]; servo: stiffness of a position servo as fitted [N m/rad | N/m], 0 where none is known.
    """

    torque: float
    max_torque: float
    velocity: float
    max_velocity: float
    deflection: float
    inertia: float
    stiffness: float
    travel: float
    input: float
    max_input: float
    output: float
    dt: float
    duration: float
    orders: tuple[float, ...] = ()
    swung: tuple[float, ...] = ()
    turns: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    following: float = 0.0
    asked: tuple[float, ...] = ()
    move: float = 0.0
    stops: tuple[tuple[int, float, float], ...] | None = None
    hold_stated: bool = True
    band: float = math.inf
    acceleration: float = 0.0
    servo: float = 0.0
