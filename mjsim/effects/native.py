"""Native values: what MJCF's own elements can say of an effect, as plain data in the units of the chain.

An effect lists the values that stand for it (`Effect.native`) and recognises the value that a file holds (`Effect.read`).
`mjsim.mjcf` writes and reads values and knows no effect; effects know no MJCF.
"""

from __future__ import annotations

from dataclasses import dataclass

from mjsim.chain import Limit

__all__ = [
    "BodyBristle",
    "Cogging",
    "CommandSlew",
    "CouplingBristle",
    "CubicSpring",
    "DriveDelay",
    "DriveLag",
    "DriveLimit",
    "DriveTorque",
    "DryFriction",
    "GroundSpring",
    "JointRange",
    "LooseLink",
    "Native",
    "SensorDelay",
    "ServoIntegral",
    "Slack",
    "SpeedLine",
    "SplitBody",
    "SquareDrag",
    "Value",
    "ViscousDamping",
    "Weight",
]


@dataclass(frozen=True)
class DryFriction:
    """Dry friction of a body against the ground: ``level`` [N m | N]."""

    body: int
    level: float


@dataclass(frozen=True)
class ViscousDamping:
    """Viscous friction of a body against the ground [N m s/rad | N s/m]."""

    body: int
    coefficient: float


@dataclass(frozen=True)
class SquareDrag:
    """Drag c v |v| on a body [N m s^2/rad^2 | N s^2/m^2]."""

    body: int
    coefficient: float


@dataclass(frozen=True)
class BodyBristle:
    """A yielding bristle (LuGre) between a body and the ground.

    level at speed and ``extra`` above it at rest [N m | N], which fades over ``speed`` [rad/s | m/s]; stiffness [N m/rad | N/m];
    damping [N m s/rad | N s/m].
    """

    body: int
    level: float
    stiffness: float
    damping: float = 0.0
    extra: float = 0.0
    speed: float = 1.0


@dataclass(frozen=True)
class CouplingBristle:
    """A yielding bristle beside the spring of a coupling: level [N m | N], stiffness [N m/rad | N/m]."""

    coupling: int
    level: float
    stiffness: float


@dataclass(frozen=True)
class Slack:
    """A gap of total ``width`` [rad | m] in a coupling, on its link side."""

    coupling: int
    width: float


@dataclass(frozen=True)
class CubicSpring:
    """A cubic term of a coupling's spring [N m/rad^3 | N/m^3]."""

    coupling: int
    coefficient: float


@dataclass(frozen=True)
class SplitBody:
    """Part of a body's inertia [kg m^2 | kg] on a further spring [N m/rad | N/m] and damper [N m s/rad | N s/m]."""

    body: int
    inertia: float
    stiffness: float
    damping: float


@dataclass(frozen=True)
class LooseLink:
    """The link of a body whose joint has a gap of total ``width`` [rad | m]: inertia behind it, contact as of `SplitBody`."""

    body: int
    inertia: float
    width: float
    stiffness: float
    damping: float


@dataclass(frozen=True)
class Weight:
    """Gravity on a body: torque -T sin(angle + phase), T [N m], phase [rad]."""

    body: int
    torque: float
    phase: float


@dataclass(frozen=True)
class GroundSpring:
    """A spring between a body and the ground: stiffness [N m/rad | N/m], rest [rad | m]."""

    body: int
    stiffness: float
    rest: float


@dataclass(frozen=True)
class JointRange:
    """Soft limits of the driven joint, over the angle of the chain."""

    limit: Limit


@dataclass(frozen=True)
class Cogging:
    """Torque amplitude sin(cycles angle + phase) on the driven body [N m | N], positive drives forward; whole cycles per turn."""

    amplitude: float
    cycles: int
    phase: float


@dataclass(frozen=True)
class DriveTorque:
    """Constant torque on the driven body [N m | N], positive drives forward."""

    torque: float


@dataclass(frozen=True)
class DriveLimit:
    """Symmetric limit of the input [unit of the input], or of the force of a servo [N m | N]."""

    limit: float


@dataclass(frozen=True)
class CommandSlew:
    """Largest speed of the target of a position servo [rad/s | m/s]."""

    limit: float


@dataclass(frozen=True)
class SpeedLine:
    """Limit of the force of a servo by its speed: at rest ``stall`` [N m | N], none at ``no_load`` [rad/s | m/s]."""

    stall: float
    no_load: float


@dataclass(frozen=True)
class DriveLag:
    """First-order lag of the input [s]."""

    time_constant: float


@dataclass(frozen=True)
class DriveDelay:
    """Delay of the input [s]."""

    delay: float


@dataclass(frozen=True)
class SensorDelay:
    """Delay of the measured signals [s]."""

    delay: float


@dataclass(frozen=True)
class ServoIntegral:
    """Integral action of a position servo: gain of the actuator's force [N m/(rad s) | N/(m s)], force at the start [N m | N]."""

    gain: float
    start: float = 0.0


Value = (
    DryFriction
    | ViscousDamping
    | SquareDrag
    | BodyBristle
    | CouplingBristle
    | Slack
    | CubicSpring
    | SplitBody
    | LooseLink
    | Weight
    | Cogging
    | CommandSlew
    | SpeedLine
    | GroundSpring
    | JointRange
    | DriveTorque
    | DriveLimit
    | DriveLag
    | DriveDelay
    | SensorDelay
    | ServoIntegral
)


@dataclass(frozen=True)
class Native:
    """The values that stand for an effect, and one line that says what they lack ("" when they are all of it)."""

    values: tuple[Value, ...] = ()
    lacks: str = ""
