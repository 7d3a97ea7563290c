"""Ports: the few ways in which physics can enter the equations of a chain.

For body i with inertia J_i and coupling j between bodies j and j+1 (deflection d_j = r_j q_j + e_j - q_{j+1}):

    J_i(q) q_i'' + J_i'(q) q_i'^2 / 2 = input - f_i q_i' - sum(coupling torques) - friction + body torques
    T_j = k_j d_j + d_j' damping_j + coupling torques            (nothing inside a gap)

An internal state s is declared in relaxation form, s' = alpha - beta s with beta >= 0, so that any runner can integrate it
without a stability limit: the law writes ``out[1] = alpha, out[2] = beta``. ``spatial`` is the highest angular frequency of a law over the angle [rad per rad | m]; runners
choose their step by it. A body torque with ``spatial`` 0 (gravity, a spring) holds the axis in place and acts at the model's own
angle; where the recorded angle is given, all other laws are tied to that, whose phase a drift of the model would lose.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from mjsim.chain import Limit
from mjsim.effects.law import Law

__all__ = [
    "BacklashLaw",
    "BodyInertia",
    "BodyTorque",
    "CommandAcceleration",
    "CommandDeadBand",
    "CommandLead",
    "CommandSlew",
    "CouplingTorque",
    "DriveLimit",
    "Friction",
    "Gap",
    "InputDelay",
    "InputLag",
    "InputMap",
    "JointLimit",
    "OutputDelay",
    "OutputLag",
    "OutputMap",
    "Port",
    "SplitInertia",
    "StaticMap",
    "TorqueSpeedLine",
    "Twist",
]


class BacklashLaw(enum.Enum):
    """What acts inside and at the edge of a gap b (Modelica ElastoBacklash, 1999 and 2007)."""

    GATED = 0  # 1999: nothing inside; k (d -+ b/2) + damping d' outside, may pull
    UNGATED = 1  # the damper acts inside the gap too: what plain MuJoCo does
    NO_PULL = 2  # 2007: as GATED but never pulling


@dataclass(frozen=True)
class Friction:
    """Set-valued friction on a body: the law writes ``out[0]`` = sliding level, ``out[1]`` = breakaway level, both >= 0 [N m | N].

    Evaluated for the direction ``z[DIRECTION]``; at rest the body sticks while the other torques stay within the breakaway levels.
    """

    body: int
    law: Law
    p: tuple[float, ...]


@dataclass(frozen=True)
class BodyTorque:
    """A torque on a body (positive drives it forward): ``out[0]`` [N m | N]; with an internal state, see the module's text.

    ``load``: whether it is that of the load, which acts on the far part of a body that is split (`SplitInertia`); ``drive``:
    whether the drive makes it, so that it is part of the torque that a chain of one body transmits.
    """

    body: int
    law: Law
    p: tuple[float, ...]
    state: bool = False
    spatial: float = 0.0
    timed: bool = False
    load: bool = False
    drive: bool = False


@dataclass(frozen=True)
class CouplingTorque:
    """A torque in a coupling, added to k d + damping d': ``out[0]`` [N m | N]."""

    coupling: int
    law: Law
    p: tuple[float, ...]
    state: bool = False


@dataclass(frozen=True)
class Twist:
    """A kinematic error e of a coupling, a function of the driving body's angle: ``out[0]`` = e, ``out[1]`` = de/dangle."""

    coupling: int
    law: Law
    p: tuple[float, ...]
    spatial: float = 0.0


@dataclass(frozen=True)
class BodyInertia:
    """A relative change of a body's inertia over its angle: ``out[0]`` = c(q) in J (1 + c), ``out[1]`` = dc/dq."""

    body: int
    law: Law
    p: tuple[float, ...]


@dataclass(frozen=True)
class Gap:
    """A dead zone of total width ``width`` [rad | m], on the coupling's own (link) side; ``contact``: the axis's when None."""

    coupling: int
    width: float
    contact: BacklashLaw | None = None


@dataclass(frozen=True)
class JointLimit:
    """Limits of the driven body's angle, in the place of those that the chain has."""

    limit: Limit


@dataclass(frozen=True)
class SplitInertia:
    """Part of a body's inertia hangs on a further spring-damper: one more degree of freedom; ``loaded``: with the body's load."""

    body: int
    inertia: float
    stiffness: float
    damping: float
    loaded: bool = False


class StaticMap(enum.Enum):
    """Memoryless signal maps, with one parameter c."""

    CLIP = "u limited to [-c, c]"
    DEAD = "u - clip(u, -c, c)"
    DROOP = "u (1 - c u^2)"
    ROUND = "c round(u / c)"
    ADD = "u + c"

    def apply(self, u: np.ndarray, c: float) -> np.ndarray:
        """The map of an array of samples."""
        match self:
            case StaticMap.CLIP:
                clipped: np.ndarray = np.clip(u, -c, c)
                return clipped
            case StaticMap.DEAD:
                excess: np.ndarray = u - np.clip(u, -c, c)
                return excess
            case StaticMap.DROOP:
                cubic: np.ndarray = u * (1.0 - c * u * u)
                return cubic
            case StaticMap.ROUND:
                return u if c == 0 else c * np.round(u / c)
            case StaticMap.ADD:
                return u + c


@dataclass(frozen=True)
class InputMap:
    """A memoryless map of the commanded torque."""

    map: StaticMap
    c: float


@dataclass(frozen=True)
class DriveLimit:
    """Largest force of the actuator, of either sign [N m | N], ahead of the gear and behind the servo's law."""

    limit: float


@dataclass(frozen=True)
class TorqueSpeedLine:
    """Largest force of the actuator at a speed v of it: ``stall`` (1 - v / ``no_load``) forward, the mirror image backward."""

    stall: float
    no_load: float


@dataclass(frozen=True)
class CommandDeadBand:
    """A band of the servo's error, ``half_width`` [rad | m] to either side, inside which its proportional part does nothing."""

    half_width: float


@dataclass(frozen=True)
class CommandSlew:
    """A limit of how fast the target of the servo follows the command [rad/s | m/s]."""

    limit: float


@dataclass(frozen=True)
class CommandAcceleration:
    """A limit of how fast the speed changes with which the target goes to the command, and stops there [rad/s^2 | m/s^2]."""

    limit: float


@dataclass(frozen=True)
class CommandLead:
    """What the servo's target is ahead of the command by its own speed: target + ``seconds`` target'."""

    seconds: float


@dataclass(frozen=True)
class InputLag:
    """First-order lag of the commanded torque, time constant [s]."""

    time_constant: float


@dataclass(frozen=True)
class InputDelay:
    """Pure delay of the commanded torque [s]."""

    delay: float


@dataclass(frozen=True)
class OutputMap:
    """A memoryless map of the measured velocity."""

    map: StaticMap
    c: float


@dataclass(frozen=True)
class OutputLag:
    """First-order lag of the measured signals, time constant [s]."""

    time_constant: float


@dataclass(frozen=True)
class OutputDelay:
    """Pure delay of the measured signals [s]."""

    delay: float


Port = (
    Friction
    | BodyTorque
    | CouplingTorque
    | Twist
    | BodyInertia
    | Gap
    | JointLimit
    | SplitInertia
    | InputMap
    | DriveLimit
    | TorqueSpeedLine
    | CommandDeadBand
    | CommandSlew
    | CommandAcceleration
    | CommandLead
    | InputLag
    | InputDelay
    | OutputMap
    | OutputLag
    | OutputDelay
)
