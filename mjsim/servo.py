"""The control law of a servo: the drive that turns a command into the force of the actuator.

    e = scale u - zero - l                       l: angle of body 0 through the gear g of the actuator (l = g q)
    position:    force = kp e - kv l'
    integrated:  the same, the target being the integral of the command (MJCF ``intvelocity``)
    velocity:    force = kv (scale u - zero - l')
    torque on body 0 = g clip(force, -limit, limit)

A velocity servo whose command is no speed (``scale`` is not 1) is a motor with a back-EMF: force = gain u - kv (zero + l'), with
gain = kv scale the torque per unit of command (per volt). Gain and kv are then two numbers of the motor.

Source: MuJoCo documentation, XML reference, ``actuator/position``, ``velocity``, ``intvelocity``.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Servo", "Target"]


class Target(enum.Enum):
    """What the command of a servo is."""

    POSITION = "position"
    VELOCITY = "velocity"
    INTEGRATED = "integrated velocity"


@dataclass(frozen=True)
class Servo:
    """A servo's law.

    kp [N m/rad | N/m] and kv [N m s/rad | N s/m] of the actuator; target: what the command is; limit [N m | N]: largest force;
    zero [rad | m, per second for a velocity]: command at which the target is zero; scale: target per unit of command;
    low, high: range to which the command is clipped.
    """

    kp: float
    kv: float
    target: Target = Target.POSITION
    limit: float = math.inf
    zero: float = 0.0
    scale: float = 1.0
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        gain, name = (self.kv, "kv") if self.target is Target.VELOCITY else (self.kp, "kp")
        if not (gain > 0 and math.isfinite(gain)):
            raise ValueError(f"{name} of a {self.target.value} servo is {gain}; expected > 0")
        if not self.limit > 0:
            raise ValueError(f"force limit of a servo is {self.limit}; expected > 0")

    @property
    def back_emf(self) -> bool:
        """Whether this is a motor with a back-EMF, whose command is no speed."""
        return self.target is Target.VELOCITY and not math.isclose(self.scale, 1.0, rel_tol=1e-12)

    @property
    def gain(self) -> float:
        """Force per unit of command [N m | N, per unit of command]."""
        return self.scale * (self.kv if self.target is Target.VELOCITY else self.kp)

    def with_numbers(self, values: Mapping[str, float]) -> Servo:
        """A copy with some of kp, kv, limit, zero and gain replaced. A motor with a back-EMF keeps its gain as kv changes."""
        own: dict[str, Any] = dict(values)
        gain = own.pop("gain", self.gain)
        new = dataclasses.replace(self, **own)
        if not self.back_emf:
            return new
        return dataclasses.replace(new, scale=gain / new.kv)
