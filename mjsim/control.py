"""The input of a recording as the drive of a model takes it: torque, command of a servo, or none.

A log may hold the control value of the actuator (``ctrl`` of MuJoCo): a voltage, a current, a duty cycle. What it does is in the
model: the control times gain and gear is the torque of a ``<motor>``, and the command of a servo is its control. A motor with a
back-EMF, driven by a voltage u, is the servo

    torque = gain u - b w,    <general gainprm="gain" biastype="affine" biasprm="0 0 -b">

Source: MuJoCo documentation, XML reference, ``actuator/general``.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from mjsim.chain import Chain
from mjsim.errors import InputError
from mjsim.recording import Recording
from mjsim.servo import Target

__all__ = ["as_driven"]

MEASURES = {"A": "a current", "V": "a voltage"}


def as_driven(chain: Chain, recording: Recording) -> Recording:
    """The recording with its control as the torque or the command that the drive of a chain takes.

    Raises InputError where the control is of another kind, or where a torque is recorded and the model has no actuator.
    """
    r = recording
    if not chain.driven:
        return _undriven(chain, r)
    if not r.driven and chain.servo is not None:
        raise InputError(
            r.source, f"the drive was off, and {chain.actuator!r} of the model is a servo, which acts without an input",
            "a model without that actuator", "use a copy of the model without it",
        )  # fmt: skip
    if r.control is None:
        return r
    if r.command is not None or np.isfinite(r.torque).all():
        return dataclasses.replace(r, control=None, control_column="")
    _need_kind(chain, r)
    if chain.servo is None:
        return dataclasses.replace(r, control=None, torque=r.control)
    return dataclasses.replace(r, control=None, command=r.control)


def _undriven(chain: Chain, r: Recording) -> Recording:
    """The recording of a model without an actuator: its torque, where it has one, is zero."""
    given = r.control if r.control is not None else r.command if r.command is not None else r.torque
    if r.driven and np.any(given != 0.0):
        joint = chain.bodies[0].joint
        raise InputError(
            r.source, "it holds an input, and the model has no actuator", f"an actuator at {joint!r}",
            f'add <motor joint="{joint}"/>; where the drive was off, write input = "none" under [recording]',
        )  # fmt: skip
    zero = np.zeros(len(r))
    return dataclasses.replace(r, torque=zero, command=None, control=None, driven=False, judge="motion")


def _need_kind(chain: Chain, r: Recording) -> None:
    """Refuse a voltage or a current that the drive does not take by its gain. The user decides where the unit is not stated."""
    unit, servo = r.units.get("control", ""), chain.servo
    if unit not in MEASURES:
        return
    what, name = MEASURES[unit], r.control_column or "COLUMN"
    if servo is None and chain.gain == 1.0:
        raise InputError(
            r.source, f"{name!r} is {what} [{unit}], and actuator {chain.actuator!r} takes a torque (gear and gain are 1)",
            "a torque, or its constant",
            f"write two lines into a TOML file beside the log: [recording] / torque = {{ column = '{name}', unit = '{unit}', "
            f"gain = X }}, with X the torque per {unit}; or give the actuator that gear",
        )  # fmt: skip
    if servo is not None and (servo.target is not Target.VELOCITY or unit == "A" or servo.scale == 1.0):
        raise InputError(
            r.source, f"{name!r} is {what} [{unit}], and {chain.actuator!r} of the model is a servo",
            f"its {servo.target.value} command",
            "bind the command ([recording] command = ...), or drive the model by <motor>",
        )  # fmt: skip
