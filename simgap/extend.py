"""What an effect of one's own is written with: ``from simgap.extend import Effect, parameter, register, ...``.

A class that is registered is simulated, fitted and named like any other effect (docs/adding_an_effect.md). A law is compiled, so
it stands in a file of its own and not in a notebook's cell.
"""

from mjsim.chain import Chain
from mjsim.effects.base import Effect, Scales, need_body, need_coupling, parameter
from mjsim.effects.law import ANGLE, DIRECTION, INPUT, LOAD, POSITION, RATE, STATE, TIME, law
from mjsim.effects.ports import (
    BodyInertia,
    BodyTorque,
    CouplingTorque,
    Friction,
    Gap,
    InputDelay,
    InputLag,
    InputMap,
    OutputDelay,
    OutputLag,
    OutputMap,
    Port,
    SplitInertia,
    Twist,
)
from mjsim.effects.registry import register
from mjsim.quantity import Motion, Quantity

__all__ = [
    "ANGLE",
    "DIRECTION",
    "INPUT",
    "LOAD",
    "POSITION",
    "RATE",
    "STATE",
    "TIME",
    "BodyInertia",
    "BodyTorque",
    "Chain",
    "CouplingTorque",
    "Effect",
    "Friction",
    "Gap",
    "InputDelay",
    "InputLag",
    "InputMap",
    "Motion",
    "OutputDelay",
    "OutputLag",
    "OutputMap",
    "Port",
    "Quantity",
    "Scales",
    "SplitInertia",
    "Twist",
    "law",
    "need_body",
    "need_coupling",
    "parameter",
    "register",
]
