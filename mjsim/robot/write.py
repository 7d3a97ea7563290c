"""The corrected MJCF of a robot: numbers that MJCF has an element for in place, the rest in ``<custom>``.

The author's file keeps its text: only attributes of joints and the ``<inertial>`` of links are changed.
"""

from __future__ import annotations

import json
import math
import tempfile
import textwrap
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.mjcf.assets import relocate
from mjsim.mjcf.compile import compile_file, save_compiled
from mjsim.mjcf.xmltext import Node, XmlText
from mjsim.robot.carried import effect_slots
from mjsim.robot.inertia import to_body
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.write_servo import NewServo, actuator_node, write_servos

__all__ = ["CUSTOM", "carried_effects", "check_writable", "write_robot"]

CUSTOM = "simgap_robot"
STEP_RATE = 1.0  # over the timestep: how fast a stiff frictionloss acts on velocity
DRY = frozenset({"friction", "extra", "sublinear", "load", "load_back"})  # slots of the level of dry friction


def write_robot(
    source: Path,
    robot: Robot,
    out: Path,
    links: np.ndarray,
    joints: Mapping[str, Mapping[str, float]],
    effects: Sequence[Mapping[str, Any]],
    servos: Sequence[NewServo] = (),
    gravcomp: float | None = None,
    soft: Collection[str] = (),
) -> None:
    """Write a corrected copy of an MJCF.

    links (L, 10): inertial parameters of each link without what is fixed to it; joints: by joint name the values of armature,
    damping (of which the actuator's part stays at the actuator), frictionloss, stiffness, springref and quadratic damping [SI]
    to write; effects: what MJCF has no element for, as JSON values, read back by `carried_effects`; servos: actuators to
    change; gravcomp: of every body that moves, None as in the file; soft: joints whose dry friction keeps the file's settings of
    the solver, others get ones that hold at rest. Raises InputError where the file cannot be written, or
    holds a link or joint in an included file.
    """
    xml = XmlText.read(source)
    model = robot.model
    for at, body in enumerate(robot.links):
        if not np.allclose(links[at], robot.nominal[at] - robot.fixed[at], rtol=1e-12, atol=1e-300):
            _inertial(xml, source, robot, body, links[at])
    degrees, timestep, rubbing = _in_degrees(xml), float(model.opt.timestep), _rubbing(effects, robot)
    for name in dict.fromkeys((*joints, *rubbing)):
        values = dict(joints.get(name, {}))
        values = values | _beside(xml, source, robot, name, values)
        attributes = _attributes(values, degrees and _is_hinge(model, robot, name))
        if name in rubbing or (values.get("frictionloss") and name not in soft):
            attributes |= _stiff(timestep)
        for key, text in attributes.items():
            xml.set(_joint(xml, source, robot, name), key, text)
    write_servos(xml, source, model, list(servos))
    if gravcomp is not None:
        for body in _moving(model):
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or ""
            xml.set(_named(xml, source, "body", name), "gravcomp", _number(gravcomp))
    _drop(xml)
    if effects:
        xml.append(xml.root, _custom(effects))
    relocate(xml, source, out)
    save_compiled(xml.raw, out, load_robot)


def _moving(model: mujoco.MjModel) -> list[int]:
    """Bodies with a mass that a joint moves."""
    return [b for b in range(1, model.nbody) if model.body_mass[b] > 0.0 and int(model.body_weldid[b]) != 0]


def check_writable(source: Path, robot: Robot, *, links: bool) -> None:
    """Dry run of `write_robot` into a temporary folder: every joint, and with ``links`` every link that has a mass of its own.

    Raises InputError, which says what cannot be written and why.
    """
    own = robot.nominal - robot.fixed
    heavy = own[:, :1] > 0.0 if links else np.zeros((len(own), 1), bool)
    joints = {name: {"armature": 0.01, "damping": 0.01, "frictionloss": 0.01} for name in robot.joints}
    with tempfile.TemporaryDirectory() as work:
        write_robot(source, robot, Path(work) / source.name, np.where(heavy, 1.01 * own, own), joints, [])


def carried_effects(path: Path) -> list[dict[str, Any]]:
    """Effects that a corrected file carries in ``<custom>``; [] for a file without."""
    model = compile_file(path)
    at = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, CUSTOM)
    if at < 0:
        return []
    start = int(model.text_adr[at])
    raw = bytes(model.text_data[start : start + int(model.text_size[at])]).split(b"\0")[0]
    try:
        return list(json.loads(raw.decode())["effects"])
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: <custom> text {CUSTOM!r}", "not readable", "what simgap writes", "take a fresh copy") from None


def _beside(xml: XmlText, source: Path, robot: Robot, name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Armature and damping of the joint itself, beside those of its actuator, which become smaller where they are above."""
    j, at, out = robot.joints.index(name), robot.leading(robot.joints.index(name)), {}
    for key, total in ((k, values[k]) for k in ("armature", "damping") if k in values):
        share = float(getattr(robot, key)[at] - getattr(robot.model, f"dof_{key}")[at])
        if share > 0.0:
            out[key] = max(total - share, 0.0)
        if 0.0 < share > total:
            xml.set(actuator_node(xml, source, robot.model, robot.actuators[j]), key, _number(total / float(robot.gear[j]) ** 2))
    return out


def _rubbing(effects: Sequence[Mapping[str, Any]], robot: Robot) -> tuple[str, ...]:
    """Joints at which a carried effect sets the level of dry friction, which acts through the joint's ``frictionloss``."""
    return tuple(dict.fromkeys(e["joint"] for e in effects if set(effect_slots(e, robot) or ()) & DRY))


def _stiff(timestep: float) -> dict[str, str]:
    """Attributes with which dry friction holds a joint: MuJoCo's default softness lets it creep under a load."""
    return {"solreffriction": f"-1 {_number(-STEP_RATE / timestep)}", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}


def _attributes(values: Mapping[str, float], degrees: bool) -> dict[str, str]:
    """Attributes of a joint: MuJoCo's damping is a polynomial of the speed."""
    out = {k: _number(math.degrees(v) if k == "springref" and degrees else v) for k, v in values.items() if k != "quadratic"}
    if "quadratic" in values:
        out["damping"] = f"{_number(values.get('damping', 0.0))} {_number(values['quadratic'])}"
    return out


def _number(value: float) -> str:
    return f"{float(value):.12g}"


def _row(values: np.ndarray) -> str:
    return " ".join(_number(v) for v in values)


def _named(xml: XmlText, source: Path, tag: str, name: str) -> Node:
    node = xml.find(lambda n: n.tag == tag and n.attributes.get("name") == name and not _within(n, "default"))
    if node is None:
        raise InputError(
            source,
            f"no <{tag} name={name!r}> in the file itself",
            "names, and no <include> of the arm",
            "name it, or join the files",
        )
    return node


def _within(node: Node, tag: str) -> bool:
    parent = node.parent
    while parent is not None:
        if parent.tag == tag:
            return True
        parent = parent.parent
    return False


def _joint(xml: XmlText, source: Path, robot: Robot, name: str) -> Node:
    return _named(xml, source, "joint", name)


def _is_hinge(model: mujoco.MjModel, robot: Robot, name: str) -> bool:
    return int(model.jnt_type[robot.dofs.index(name)]) == int(mujoco.mjtJoint.mjJNT_HINGE)


def _in_degrees(xml: XmlText) -> bool:
    compiler = xml.root.child("compiler")
    return compiler is None or compiler.attributes.get("angle", "degree") == "degree"


def _inertial(xml: XmlText, source: Path, robot: Robot, body: int, phi: np.ndarray) -> None:
    """Give a body an explicit inertial; what its geoms weigh no longer counts."""
    name = mujoco.mj_id2name(robot.model, mujoco.mjtObj.mjOBJ_BODY, body) or ""
    mass, centre, quat, principal = to_body(phi)
    attributes = {"pos": _row(centre), "quat": _row(quat), "mass": _number(mass), "diaginertia": _row(principal)}
    node = _named(xml, source, "body", name)
    old = node.child("inertial")
    if old is not None:
        xml.remove(old)
    node = _named(xml, source, "body", name)
    line = "<inertial " + " ".join(f'{k}="{v}"' for k, v in attributes.items()) + "/>"
    if node.children:
        xml.insert_before(node.children[0], [line])
    else:
        xml.append(node, [line])


def _drop(xml: XmlText) -> None:
    """Remove what an earlier correction carries."""
    node = xml.find(lambda n: n.tag == "text" and n.attributes.get("name") == CUSTOM)
    if node is not None:
        alone = node.parent is not None and len(node.parent.children) == 1
        xml.remove(node.parent if alone and node.parent is not None else node)


def _custom(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    said = "Plain MuJoCo lacks: " + "; ".join(f"{e['effect'].replace('_', ' ')} at {e['joint']}" for e in effects) + "."
    text = escape(json.dumps({"version": 1, "effects": list(effects)}), {"'": "&apos;"})
    lines = ["<!--", *(f"  {line}" for line in textwrap.wrap(said.replace("--", "- -"), 120)), "-->"]
    return ["<custom>", *(f"  {line}" for line in lines), f"  <text name=\"{CUSTOM}\" data='{text}'/>", "</custom>"]
