"""Integral action of a position servo: beside kp and kv it has a force in proportion to the integral of its error (PID).

force = kp e - kv l' + T0 + ki (integral of e dt since the first sample),    e: the error of the servo

T0 is the force that the integral has at the first sample. A cascade of a position and a velocity loop has another weight of the
command: a law of its own, integral action of a cascade.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.admissible import Range, servo_stiffness
from mjsim.effects.base import Effect, Scales, need_servo, parameter
from mjsim.effects.law import INPUT, POSITION, STATE, law
from mjsim.effects.native import Native, ServoIntegral, Value
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["IntegralAction"]

RATES = (0.3, 1.0, 4.0)  # ki / kp [1/s] of the starts: a tuned PID integrates within some tenths of a second to some seconds


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """T0 + ki s at body 0; s' = u - l."""
    out[0] = p[1] + p[0] * z[STATE]
    out[1] = z[INPUT] - p[2] * z[POSITION]
    out[2] = 0.0


@register
@dataclass(frozen=True, kw_only=True)
class IntegralAction(Effect):
    """Integral action of a position servo; law, convention and source as in the module's text."""

    id: ClassVar[str] = "integral_action"
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = "The servo has integral action: beside kp and kv, {gain_Nm_rad_s} on the integral of its error."
    citation: ClassVar[str] = "K. J. Astrom, T. Hagglund, Advanced PID Control (2006), ch. 3; MuJoCo XML reference, actuator/pid"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("gain_Nm_rad_s",)
    family: ClassVar[str] = "servo"
    multistart: ClassVar[int] = 2
    start_parameter: ClassVar[str] = "start_Nm"
    closes_loop: ClassVar[bool] = True

    gain_Nm_rad_s: float = parameter(Quantity.INTEGRAL_GAIN, "force of the actuator per integral of the error", lower=0.0)
    start_Nm: float = parameter(Quantity.TORQUE, "force of the integral at the first sample", default=0.0, nuisance=True)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_servo(chain, position=True)
        g = chain.gain
        return (BodyTorque(0, torque, (g * self.gain_Nm_rad_s, g * self.start_Nm, g), state=True, drive=True),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((ServoIntegral(self.gain_Nm_rad_s, self.start_Nm),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, ServoIntegral):
            return None
        return cls(gain_Nm_rad_s=value.gain, start_Nm=value.start)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        most = servo_stiffness(scales) / scales.dt
        return (Range("integral gain", self.gain_Nm_rad_s, 0.0, most, "which turns the force over within a sample"),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [{"gain_Nm_rad_s": rate * servo_stiffness(scales), "start_Nm": 0.0} for rate in RATES]
