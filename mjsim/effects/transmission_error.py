"""Transmission error: the gear's output angle departs from the ratio, periodically in the motor angle.

d = r q_m + e - q_g,  e = a sin(n angle_m + phase)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range, wave
from mjsim.effects.base import Effect, Scales, need_coupling, parameter
from mjsim.effects.law import ANGLE, law
from mjsim.effects.ports import Port, Twist
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["TransmissionError"]


@law
def error(z: Any, p: Any, out: Any) -> None:
    """A sin(n angle + phase) and its slope."""
    x = p[1] * z[ANGLE] + p[2]
    out[0] = p[0] * math.sin(x)
    out[1] = p[0] * p[1] * math.cos(x)


@register
@dataclass(frozen=True, kw_only=True)
class TransmissionError(Effect):
    """Transmission error; law, convention and source as in the module's text."""

    id: ClassVar[str] = "transmission_error"
    places: ClassVar[tuple[str, ...]] = ("gearbox",)
    sentence: ClassVar[str] = (
        "Transmission error in the {place}: {amplitude_rad} on the link side, repeating at {cycles_per_rev} of the motor."
    )
    citation: ClassVar[str] = "Gravagno, Mucino, Pennestri, Mechanism and Machine Theory 152 (2020); ISO 230-2"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("amplitude_rad",)
    family: ClassVar[str] = "position"
    multistart: ClassVar[int] = 3
    angle_of: ClassVar[str] = "motor"

    amplitude_rad: float = parameter(Quantity.ANGLE, "amplitude, link side", lower=0.0)
    cycles_per_rev: float = parameter(Quantity.CYCLES, "periods per turn of the motor", lower=0.0)
    phase_rad: float = parameter(Quantity.PHASE, "phase at angle zero", nuisance=True)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (self.amplitude_rad, self.cycles_per_rev, self.phase_rad)
        return (Twist(need_coupling(chain, self.place), error, p, spatial=self.cycles_per_rev),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return wave(self.cycles_per_rev, scales)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [
            {"amplitude_rad": 0.1 * scales.deflection, "cycles_per_rev": n, "phase_rad": 0.0}
            for n in dict.fromkeys((*scales.orders[:4], 1.0, 2.0, 3.0, 4.0))
        ]
