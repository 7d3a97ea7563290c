"""What the motion of the recordings can show: one line a family of effects, with the numbers that decide."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.relation import TOP, Signals
from diagnose.check.spectrum import Spectrum, clear_band
from diagnose.check.thresholds import MODE_RATE
from diagnose.check.types import Excitation

__all__ = ["Motion", "excitation", "families", "motion_from", "motion_of"]

_REVERSALS = 4  # two there and back: a constant torque, an offset and their difference by direction are three numbers
_PERIODS = 3  # of a position-locked effect: amplitude, phase and one more to test them
_ANGLE = math.pi / 6  # [rad] range over which the sine of the angle differs from a straight line by 1 % or more
_SLOW = 0.05  # of the rms speed: below it the axis is at rest


@dataclass(frozen=True)
class Motion:
    """Highest frequency of the motion above its noise [Hz]; reversals of velocity and torque; range of angle; largest speed."""

    bandwidth: float
    reversals: int
    load_changes: int
    travel: float
    speed: float
    both_ways: bool


def motion_of(context: Context) -> Motion | None:
    """The motion of one recording, under its chosen scale; None without a response."""
    s = context.mended or context.signals
    return None if s is None else motion_from(s, context.noise[context.response] * _scale_of(context))


def motion_from(s: Signals, noise: float) -> Motion:
    """The motion of signals whose response, the velocity where there is one, has a noise of this rms.

    ``s.torque``: the torque of the drive, or what is proportional to it, whose changes of sign are counted.
    """
    motion = s.velocity if s.velocity is not None else s.angle
    assert motion is not None
    limit = min(TOP * MODE_RATE, 0.45 / s.dt)
    spectrum = Spectrum.of(motion, s.dt, limit)
    band = clear_band(spectrum, noise, s.dt)
    count = max(2, min(len(motion) - 1, math.floor(4 * band * spectrum.duration)))
    v = spectrum.derivative(0 if s.velocity is not None else 1, count)
    level = _SLOW * float(np.sqrt(np.mean(v**2)))
    angle = s.angle if s.angle is not None else np.cumsum(motion) * s.dt
    load = s.torque - np.mean(s.torque)
    return Motion(
        band, _changes(v, level), _changes(load, _SLOW * float(np.std(load))), float(np.ptp(angle)), float(np.max(np.abs(v))),
        bool(np.any(v > level) and np.any(v < -level)),
    )  # fmt: skip


def _scale_of(context: Context) -> float:
    scale = context.scale
    return 1.0 if scale is None else abs(getattr(scale.chosen, context.response))


def _changes(x: np.ndarray, level: float) -> int:
    """Changes of sign of a signal, with the hysteresis of a level."""
    signs = np.sign(x[np.abs(x) > level])
    return int(np.sum(np.diff(signs) != 0))


def excitation(contexts: Sequence[Context], machine: Machine) -> list[Excitation]:
    """One line a family, over all recordings together."""
    motions = [m for c in contexts if (m := motion_of(c)) is not None]
    if not motions:
        return []
    return families(motions, min(1 / c.signals.dt for c in contexts if c.signals is not None), machine)


def families(motions: Sequence[Motion], rate: float, machine: Machine) -> list[Excitation]:
    """One line a family, of motions that were sampled at ``rate`` [1/s] and faster."""
    band = max(m.bandwidth for m in motions)
    reversals = sum(m.reversals for m in motions)
    changes = sum(m.load_changes for m in motions)
    travel = max(m.travel for m in motions)
    both = any(m.both_ways for m in motions)
    unit = "rad" if machine.hinge else "m"
    out = [
        Excitation(
            "friction", both and reversals >= _REVERSALS,
            f"{reversals} reversals of velocity ({_REVERSALS} needed)" + ("" if both else "; the axis moves one way only"),
        ),
        Excitation("offset", both, "both directions of motion" if both else "one direction: an offset and friction look alike"),
    ]  # fmt: skip
    if len(machine.chain.bodies) > 1 or machine.gears:
        out.append(Excitation("gap of the gear", changes >= _REVERSALS, f"{changes} changes of load sign ({_REVERSALS} needed)"))
    reach = min(rate / MODE_RATE, band)
    for mode in machine.modes:
        word = "reached" if mode < reach else "not reached"
        out.append(
            Excitation(f"mode at {mode:.4g} Hz", mode < reach, f"{word}: the motion stands above its noise up to {band:.4g} Hz")
        )
    if machine.hinge:
        turns = travel / (2 * math.pi)
        out.append(
            Excitation(
                "position-locked effects", turns >= _PERIODS,
                f"the angle ranges over {travel:.4g} {unit}, {turns:.3g} turns: laws from {_PERIODS / turns:.3g} cycles a turn on"
                if turns > 0 else "the angle does not move",
            )
        )  # fmt: skip
        last = travel * abs(float(machine.ratios[-1]))
        out.append(Excitation("gravity", last > _ANGLE, f"the last body turns over {last:.4g} rad ({_ANGLE:.3g} needed)"))
    return out
