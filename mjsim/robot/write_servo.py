"""The servos of a robot in a copy of its MJCF: gains, zero and force limit, as the ``<general>`` that every servo stands for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco

from mjsim.errors import InputError
from mjsim.mjcf.general import SHORT
from mjsim.mjcf.servo import bias_of
from mjsim.mjcf.xmltext import Node, XmlText
from mjsim.servo import Servo, Target

__all__ = ["NewServo", "write_servos"]


@dataclass(frozen=True)
class NewServo:
    """A servo to write: the actuator by its index, its law in the file and the new one."""

    actuator: int
    old: Servo
    new: Servo


def write_servos(xml: XmlText, source: Path, model: mujoco.MjModel, servos: list[NewServo]) -> None:
    """Change the actuators of ``xml`` in place where their law differs. Raises InputError for one without a name in the file."""
    for s in servos:
        if s.new != s.old:
            _write(xml, source, model, s)


def _write(xml: XmlText, source: Path, model: mujoco.MjModel, s: NewServo) -> None:
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, s.actuator) or ""

    def node() -> Node:
        found = xml.find(lambda n: n.attributes.get("name") == name and n.parent is not None and n.parent.tag == "actuator")
        if found is None:
            raise InputError(
                source, f"no actuator {name!r} in the file itself", "names, and no <include>", "name it, or join the files"
            )
        return found

    tag, attributes = node().tag, node().attributes
    values: dict[str, str | None] = {key: None for key in SHORT if key in attributes}
    if int(model.actuator_dyntype[s.actuator]) in (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT)):
        values |= {"dyntype": "filterexact", "dynprm": _number(float(model.actuator_dynprm[s.actuator, 0]))}
    elif tag == "intvelocity":
        values["dyntype"] = "integrator"
    if "inheritrange" in attributes:
        low, high = map(float, model.actuator_ctrlrange[s.actuator])
        values |= {"ctrllimited": "true", "ctrlrange": f"{_number(low)} {_number(high)}"}
    own = s.new.kv if s.new.target is Target.VELOCITY else s.new.kp
    values |= {
        "gaintype": "fixed", "gainprm": _number(own * s.new.scale), "biastype": "affine",
        "biasprm": " ".join(_number(x) for x in bias_of(s.new)),
    }  # fmt: skip
    if math.isfinite(s.new.limit) and s.new.limit != s.old.limit:
        values |= {"forcelimited": "true", "forcerange": f"{_number(-s.new.limit)} {_number(s.new.limit)}"}
    for key, value in values.items():
        xml.set(node(), key, value)
    if tag != "general":
        xml.rename(node(), "general")


def _number(value: float) -> str:
    return f"{float(value):.12g}"
