"""Torque ripple (cogging): a torque locked to the motor angle.

tau_r = a sin(n angle + phase), opposing the motor
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.admissible import Range, wave
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import ANGLE, law
from mjsim.effects.native import Cogging, Native, Value
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["TorqueRipple"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """-a sin(n angle + phase)."""
    out[0] = -p[0] * math.sin(p[1] * z[ANGLE] + p[2])


@register
@dataclass(frozen=True, kw_only=True)
class TorqueRipple(Effect):
    """Torque ripple; law, convention and source as in the module's text."""

    id: ClassVar[str] = "torque_ripple"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "Torque ripple at the {place}: {amplitude_Nm}, repeating at {cycles_per_rev} (cogging, commutation or a ball screw)."
    )
    citation: ClassVar[str] = "Holtz, Springob, IEEE Trans. Ind. El. 43 (1996) 330"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("amplitude_Nm",)
    family: ClassVar[str] = "position"
    multistart: ClassVar[int] = 3

    amplitude_Nm: float = parameter(Quantity.TORQUE, "amplitude", lower=0.0)
    cycles_per_rev: float = parameter(Quantity.CYCLES, "periods per turn of the motor", lower=0.0)
    phase_rad: float = parameter(Quantity.PHASE, "phase at angle zero", nuisance=True)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (self.amplitude_Nm, self.cycles_per_rev, self.phase_rad)
        return (BodyTorque(need_body(chain, self.place), torque, p, spatial=self.cycles_per_rev),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        cycles = round(self.cycles_per_rev)
        if abs(cycles - self.cycles_per_rev) > 1e-9:
            return Native((), f"torque ripple of {self.cycles_per_rev:.6g} periods per turn: <dcmotor> takes whole numbers")
        # cogging drives forward, the law here opposes: half a turn of phase
        return Native((Cogging(self.amplitude_Nm, cycles, self.phase_rad + math.pi),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, Cogging):
            return None
        return cls(amplitude_Nm=value.amplitude, cycles_per_rev=value.cycles, phase_rad=value.phase - math.pi)

    def limits(self) -> tuple[Effect, ...]:
        """A weight, where the torque repeats once a turn."""
        from mjsim.effects.gravity_load import GravityLoad

        if round(self.cycles_per_rev) != 1:
            return ()
        return (GravityLoad(torque_Nm=self.amplitude_Nm, phase_rad=self.phase_rad),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return wave(self.cycles_per_rev, scales)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [
            {"amplitude_Nm": 0.05 * scales.torque, "cycles_per_rev": n, "phase_rad": 0.0}
            for n in dict.fromkeys((*scales.orders[:4], *scales.turns))
        ]
