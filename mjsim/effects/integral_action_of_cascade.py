"""Integral action of a cascade: a position loop K whose output is the target of a velocity loop (gain D, integral gain I).

force = D (K e - l') + I (integral of K e - l' dt) + T0 = kp e - kv l' + T0 + ki (integral of e dt) - w (c - c_0)

with kp = D K + I, kv = D, ki = I K and w = I: the command acts through D K alone. c: target of the servo, c_0: constant, in T0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range
from mjsim.effects.base import Effect, Scales, need_servo, parameter
from mjsim.effects.integral_action import IntegralAction
from mjsim.effects.law import INPUT, POSITION, STATE, law
from mjsim.effects.ports import BodyTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["IntegralActionOfCascade"]

INTEGRAL = 5.0  # I / D [1/s] of the starts: a velocity loop integrates within some tenths of a second


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """T0 + ki s - w u at body 0; s' = u - l."""
    out[0] = p[1] + p[0] * z[STATE] - p[3] * z[INPUT]
    out[1] = z[INPUT] - p[2] * z[POSITION]
    out[2] = 0.0


@register
@dataclass(frozen=True, kw_only=True)
class IntegralActionOfCascade(Effect):
    """Integral action of a cascade; law, convention and source as in the module's text."""

    id: ClassVar[str] = "integral_action_of_cascade"
    form_of: ClassVar[str] = "integral_action"
    refines: ClassVar[tuple[str, ...]] = ("integral_action",)
    places: ClassVar[tuple[str, ...]] = ("actuator",)
    sentence: ClassVar[str] = (
        "The servo is a cascade with integral action in its velocity loop: beside kp and kv, {gain_Nm_rad_s} on the integral of its "
        "error, and {weight_Nm_rad} less of its gain on the command."
    )
    citation: ClassVar[str] = "K. J. Astrom, T. Hagglund, Advanced PID Control (2006), ch. 3 and 12"
    tolerance: ClassVar[float] = 1e-4
    amplitudes: ClassVar[tuple[str, ...]] = ("gain_Nm_rad_s", "weight_Nm_rad")
    family: ClassVar[str] = "servo"
    multistart: ClassVar[int] = 2
    start_parameter: ClassVar[str] = "start_Nm"
    closes_loop: ClassVar[bool] = True

    gain_Nm_rad_s: float = parameter(Quantity.INTEGRAL_GAIN, "force of the actuator per integral of the error", lower=0.0)
    weight_Nm_rad: float = parameter(Quantity.STIFFNESS, "gain on the position that the command does not have", lower=0.0)
    start_Nm: float = parameter(Quantity.TORQUE, "force of the integral at the first sample", default=0.0, nuisance=True)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        need_servo(chain, position=True)
        g = chain.gain
        p = (g * self.gain_Nm_rad_s, g * self.start_Nm, g, g * self.weight_Nm_rad)
        return (BodyTorque(0, torque, p, state=True, drive=True),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return IntegralAction(gain_Nm_rad_s=self.gain_Nm_rad_s).admissible(scales)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        plain = IntegralAction.starts(scales)
        return [{**values, "weight_Nm_rad": values["gain_Nm_rad_s"] / INTEGRAL} for values in plain]
