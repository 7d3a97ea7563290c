"""The servos of a robot in a copy of its MJCF: gains, zero and force limit, as the ``<general>`` that every servo stands for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco

from mjsim.errors import InputError
from mjsim.mjcf.drive_laws import IMAX, Form, law_of
from mjsim.mjcf.general import spelled_out
from mjsim.mjcf.servo import bias_of
from mjsim.mjcf.xmltext import Node, XmlText
from mjsim.servo import Servo, Target

__all__ = ["NewServo", "actuator_node", "can_be_pid", "write_servos"]


@dataclass(frozen=True)
class NewServo:
    """A servo to write: the actuator by its index, its law in the file and the new one.

    slew: largest speed of its setpoint [rad/s | m/s], ki: gain of its integral action [N m/(rad s) | N/(m s)], None where the
    file's stays (`can_be_pid` says where one can be written).
    """

    actuator: int
    old: Servo
    new: Servo
    slew: float | None = None
    ki: float | None = None


def write_servos(xml: XmlText, source: Path, model: mujoco.MjModel, servos: list[NewServo]) -> None:
    """Change the actuators of ``xml`` in place where their law differs. Raises InputError for one without a name in the file."""
    for s in servos:
        if s.new != s.old or s.slew is not None or s.ki is not None:
            _write(xml, source, model, s)


def can_be_pid(model: mujoco.MjModel, a: int, servo: Servo) -> bool:
    """Whether slewmax and ki can be written at a servo: it is a ``<pid>`` of a position, or can be one."""
    lagged = law_of(model, a).form is Form.GENERAL and int(model.actuator_dyntype[a]) != int(mujoco.mjtDyn.mjDYN_NONE)
    return servo.target is Target.POSITION and servo.scale == 1.0 and not lagged


def actuator_node(xml: XmlText, source: Path, model: mujoco.MjModel, a: int) -> Node:
    """The element of an actuator. Raises InputError where it has no name in the file itself."""
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, a) or ""
    found = xml.find(lambda n: n.attributes.get("name") == name and n.parent is not None and n.parent.tag == "actuator")
    if found is None:
        raise InputError(
            source, f"no actuator {name!r} in the file itself", "names, and no <include>", "name it, or join the files"
        )
    return found


def _write(xml: XmlText, source: Path, model: mujoco.MjModel, s: NewServo) -> None:
    def node() -> Node:
        return actuator_node(xml, source, model, s.actuator)

    tag = node().tag
    values = spelled_out(model, s.actuator, node().attributes)
    if values["dyntype"] == "filter":
        values["dyntype"] = "filterexact"
    law = law_of(model, s.actuator)
    ki = law.integral if s.ki is None else s.ki  # beside integral action a constant force is a part of its start
    bias = (law.constant if law.integral else 0.0, -s.new.kp, -s.new.kv) if ki else bias_of(s.new)
    values["biasprm"] = " ".join(_number(x) for x in bias)
    if values["gaintype"] == "fixed":  # that of a <pid> is in its bias
        values["gainprm"] = _number(s.new.gain)
    if s.slew is not None or s.ki is not None:
        imax = float(model.actuator_dynprm[s.actuator, IMAX]) if law.form is Form.PID else 0.0
        slew = s.slew if s.slew is not None else (law.slew if math.isfinite(law.slew) else 0.0)
        values |= {"dyntype": "pid", "dynprm": f"{_number(imax)} {_number(slew)}"}
        values |= {} if values["gaintype"] == "pid" else {"gaintype": "pid", "input": "pos"}
        values["gainprm"] = _number(ki)
    if math.isfinite(s.new.limit) and s.new.limit != s.old.limit:
        values |= {"forcelimited": "true", "forcerange": f"{_number(-s.new.limit)} {_number(s.new.limit)}"}
    for key, value in values.items():
        xml.set(node(), key, value)
    if tag != "general":
        xml.rename(node(), "general")


def _number(value: float) -> str:
    return f"{float(value):.12g}"
