"""Torque gain droop: the motor's torque constant falls as it saturates.

tau = u (1 - c u^2)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_torque_input, parameter
from mjsim.effects.ports import InputMap, Port, StaticMap
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["TorqueGainDroop"]


@register
@dataclass(frozen=True, kw_only=True)
class TorqueGainDroop(Effect):
    """Torque gain droop; law, convention and source as in the module's text."""

    id: ClassVar[str] = "torque_gain_droop"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = (
        "The torque falls short of its command as it grows ({coefficient_per_Nm2} of its square): the motor's iron saturates."
    )
    citation: ClassVar[str] = "Krause, Wasynczuk, Sudhoff, Analysis of Electric Machinery (2002)"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("coefficient_per_Nm2",)
    family: ClassVar[str] = "signal"

    coefficient_per_Nm2: float = parameter(Quantity.PER_TORQUE_SQUARED, "relative loss per torque squared", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_torque_input(chain)
        return (InputMap(StaticMap.DROOP, self.coefficient_per_Nm2),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        lost = self.coefficient_per_Nm2 * scales.max_input**2
        return (Range("relative loss at the largest command", lost, 0.0, 1.0, "beyond which more command gives less torque"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"coefficient_per_Nm2": 0.05 / scales.max_input**2}]
