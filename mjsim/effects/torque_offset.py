"""Torque offset: a constant torque at the motor, beside the commanded one.

tau = u + tau_0: positive drives forward (an amplifier's bias, a spring, gravity at one pose)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.law import law
from mjsim.effects.native import DriveTorque, Native, Value
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["TorqueOffset"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """tau_0."""
    out[0] = p[0]


@register
@dataclass(frozen=True, kw_only=True)
class TorqueOffset(Effect):
    """Torque offset; law, convention and source as in the module's text."""

    id: ClassVar[str] = "torque_offset"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = (
        "A constant torque of {torque_Nm} at the {place} beside the commanded one (amplifier offset, preload or weight)."
    )
    citation: ClassVar[str] = "Gautier, Venture, Proc. IFAC SYSID (2012)"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm",)
    family: ClassVar[str] = "offset"
    taken_for: ClassVar[tuple[str, ...]] = ("sensor_offset",)

    torque_Nm: float = parameter(Quantity.TORQUE, "offset, positive drives forward")

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (BodyTorque(need_body(chain, self.place), torque, (self.torque_Nm,)),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((DriveTorque(self.torque_Nm),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        return cls(torque_Nm=value.torque) if isinstance(value, DriveTorque) else None

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"torque_Nm": 0.02 * scales.torque}]
