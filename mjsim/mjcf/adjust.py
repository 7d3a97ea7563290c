"""What is changed in a corrected file once it is written: settings of the simulator, and what it carries."""

from __future__ import annotations

import textwrap
from collections.abc import Container, Sequence
from dataclasses import replace
from pathlib import Path

from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.mjcf import custom
from mjsim.mjcf.compile import save_compiled
from mjsim.mjcf.custom import Carried, Edit
from mjsim.mjcf.xmltext import Node, XmlText

__all__ = ["FRICTION_SETTINGS", "LIMIT_SETTINGS", "adjust", "author_settings", "carry"]

FRICTION_SETTINGS = ("solreffriction", "solimpfriction")
LIMIT_SETTINGS = ("solreflimit", "solimplimit", "armature")  # armature: of the slack joint
_SHORTENS = ("solreflimit", "delay")  # attributes whose forms need a short timestep too, as added actuators do


def author_settings(carried: Carried, found: Container[str | None] = ()) -> list[Edit]:
    """Edits that give dry friction and limits back the solver settings and the timestep that the author's file has.

    Limits: of joints that the author's file limits already, and does not hold within their limits. Those of the joints ``found``
    stay: how stiff they are was fitted.
    """
    held = any((kind, key) == ("equality", "active") for kind, _, key, _ in carried.undo)
    ranges = {name for kind, name, key, old in carried.undo if (kind, key) == ("joint", "range") and old is not None}
    limited = set() if held else {name for name in ranges if name not in found}
    back = [
        (kind, name, key, old)
        for kind, name, key, old in carried.undo
        if key in FRICTION_SETTINGS or (name in limited and key in LIMIT_SETTINGS)
    ]
    given = {edit[:3] for edit in back}
    short = any(key in _SHORTENS and (kind, name, key) not in given for kind, name, key, _ in carried.undo)
    short = short or any(kind == "actuator" for kind, _ in carried.added)
    if not short:
        back += [edit for edit in carried.undo if edit[0] == "option" and edit[2] == "timestep"]
    oldest: dict[tuple[str, str, str], Edit] = {}
    for edit in back:
        oldest.setdefault(edit[:3], edit)
    return list(oldest.values())


def adjust(path: Path, edits: Sequence[Edit], comment: str = "") -> None:
    """Set attributes (kind, name, attribute, value or None) of a corrected file, and note them in what it carries.

    Kinds: option, joint, tendon. ``comment`` is put before the carried text. The file is replaced once MuJoCo has loaded it.
    Raises InputError where an element is not there under its name.
    """
    xml = XmlText.read(path)
    node = _carrying(xml)
    if node is None:
        raise InputError(path, "carries no correction", "a file that `simgap diagnose` wrote", "write it first")
    carried = custom.unpack(node.attributes["data"], path)
    undo = list(carried.undo)
    for kind, name, key, value in edits:
        target = _element(xml, path, kind, name)
        now = target.attributes.get(key)
        if now == value:
            continue
        noted = next((e for e in undo if e[:3] == (kind, name, key)), None)
        if noted is None:
            undo.append((kind, name, key, now))
        elif noted[3] == value:
            undo = [e for e in undo if e[:3] != (kind, name, key)]
        xml.set(target, key, value)
    _replace(xml, replace(carried, undo=tuple(undo)), comment)
    save_compiled(xml.raw, path)


def carry(path: Path, axis: Axis, lacks: Sequence[tuple[str, str]], comment: str = "") -> None:
    """Let a corrected file carry an axis, whatever MJCF's elements have in its place.

    ``lacks`` (effect, line): what plain MuJoCo does without. ``comment`` is put before the carried text. Raises InputError where
    the file carries no correction.
    """
    xml = XmlText.read(path)
    node = _carrying(xml)
    if node is None:
        raise InputError(path, "carries no correction", "a file that `simgap diagnose` wrote", "write it first")
    linear = tuple((p.name, p.value) for p in axis.chain.linear_parameters())
    carried = custom.unpack(node.attributes["data"], path)
    _replace(xml, replace(carried, effects=axis.effects, law=axis.backlash_law, lacks=tuple(lacks), linear=linear), comment)
    save_compiled(xml.raw, path)


def _replace(xml: XmlText, carried: Carried, comment: str) -> None:
    """Put another carried text, after a comment, in place of the one that is there."""
    before = _carrying(xml)
    assert before is not None
    said = textwrap.wrap(comment.replace("--", "- -"), 120)
    xml.insert_before(before, [*(["<!--", *(f"  {line}" for line in said), "-->"] if said else []), *custom.element(carried)])
    stale = [n for n in xml.root.walk() if n.tag == "text" and n.attributes.get("name") == custom.NAME][-1]
    xml.remove(stale)


def _carrying(xml: XmlText) -> Node | None:
    """The element of the carried text."""
    return xml.find(lambda n: n.tag == "text" and n.attributes.get("name") == custom.NAME)


def _element(xml: XmlText, path: Path, kind: str, name: str) -> Node:
    if kind == "option":
        node = xml.root.child("option")
        if node is None:
            xml.insert_before(xml.root.children[0], ["<option/>"])
            node = xml.root.child("option")
        assert node is not None
        return node

    def wanted(n: Node) -> bool:
        if n.attributes.get("name") != name:
            return False
        return (n.parent is not None and n.parent.tag == "tendon") if kind == "tendon" else n.tag == kind

    found = xml.find(wanted) if name else None
    if found is None:
        raise InputError(path, f"{kind} {name!r} is not in this file", "elements with names, in one file", "name it")
    return found
