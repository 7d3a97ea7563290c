"""Which effects of a structure have numbers that the recording cannot show, by the ranges that they declare themselves."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import final

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from mjsim.effects import Effect, Scales
from mjsim.effects.admissible import Range

__all__ = ["Outside", "out_of_range", "scales_of"]


@final
@dataclass(frozen=True)
class Outside:
    """An effect, and a range that it declares and does not keep."""

    effect: Effect
    range: Range


def scales_of(fitter: Fitter, effect: Effect) -> Scales:
    """Scales where an effect stands, with the motion of the angle that its law follows."""
    cls = type(effect)
    turning = fitter.scales[cls.angle_of or effect.place]
    own = fitter.scales_for(cls, effect.place)
    band = fitter.view.band(fitter.experiments[0].recording.dt)
    return dataclasses.replace(own, travel=turning.travel, velocity=turning.velocity, turns=turning.turns, band=band)


def out_of_range(f: Fitted, fitter: Fitter) -> tuple[Outside, ...]:
    """The ranges that supposed effects of a structure leave."""
    servo = f.axis.chain.servo
    kp = servo.kp if servo is not None and servo.kp > 0 else 0.0
    scales = {e: dataclasses.replace(scales_of(fitter, e), servo=kp) for e in f.effects}
    return tuple(Outside(e, r) for e, own in scales.items() for r in e.admissible(own) if not r.holds)
