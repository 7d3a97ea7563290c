"""The control law of a servo: the drive that turns a command into the force of the actuator.

    e = scale u - zero - l                       l: angle of body 0 through the gear g of the actuator (l = g q)
    position:    force = kp e - kv l'
    integrated:  the same, the target being the integral of the command (MJCF ``intvelocity``)
    velocity:    force = kv (scale u - zero - l')
    torque on body 0 = g clip(force, -limit, limit)

Source: MuJoCo documentation, XML reference, ``actuator/position``, ``velocity``, ``intvelocity``.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

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
