"""Edits of a copy of an authored MJCF: attributes and elements, each recorded so that it can be undone."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from mjsim.chain import Chain
from mjsim.errors import InputError
from mjsim.mjcf.assets import relocate
from mjsim.mjcf.chain import Found
from mjsim.mjcf.general import spelled_out
from mjsim.mjcf.xmltext import Node, XmlText

__all__ = ["MjcfEditor", "element", "number", "row", "stiffest"]


def number(value: float) -> str:
    """Shortest text that reads back as the same number."""
    text = repr(float(value))
    return text.removesuffix(".0")


def stiffest(timestep: float) -> str:
    """solref of a limit that is critically damped and as stiff as the step [s] allows."""
    return row([-float(f"{1 / timestep**2:.6g}"), -float(f"{2 / timestep:.6g}")])


def row(values: Sequence[float]) -> str:
    """Numbers as the text of an attribute."""
    return " ".join(number(v) for v in values)


def element(tag: str, *, close: bool = True, **attributes: str) -> str:
    """The text of an element, its attributes escaped."""
    text = "".join(f" {key}={quoteattr(value)}" for key, value in attributes.items())
    return f"<{tag}{text}{'/' if close else ''}>"


class MjcfEditor:
    """Edits a copy of an authored MJCF whose chain is known.

    ``undo`` lists what was changed, newest last, as (element, attribute, old value or None); ``added`` names elements that were
    added; ``ignored`` those among them (and others) that stand for an effect and are no part of the chain.
    """

    def __init__(self, path: Path, found: Found) -> None:
        self.path = path
        self.found = found
        self.xml = XmlText.read(path)
        self.added: list[tuple[str, str]] = []
        self.ignored: list[str] = []
        self.undo: list[tuple[str, str, str, str | None]] = []
        self._following: list[Callable[[], None]] = []

    @property
    def chain(self) -> Chain:
        """The chain as the file had it."""
        return self.found.chain

    @property
    def model(self) -> mujoco.MjModel:
        """The file as it was, compiled."""
        return self.found.layout.model

    # ---- elements -------------------------------------------------------------------------------------------------------

    def node(self, kind: str, name: str) -> Node:
        """The element of a kind (joint, body, tendon, actuator, sensor, equality) with a name, in this file."""
        sections = {"tendon": "tendon", "actuator": "actuator", "sensor": "sensor", "equality": "equality"}

        def wanted(n: Node) -> bool:
            if n.attributes.get("name") != name:
                return False
            if kind in sections:
                return n.parent is not None and n.parent.tag == sections[kind]
            return n.tag == ("body" if kind == "inertial" else kind)

        found = self.xml.find(wanted) if name else None
        if found is not None and kind == "inertial":
            found = found.child("inertial")
        if found is None:
            raise InputError(
                self.path, f"{kind} {name!r} is not in this file under that name" if name else f"a {kind} has no name",
                "every element of the chain named, in one file",
                "name it, or merge included files into one",
            )  # fmt: skip
        return found

    def set(self, kind: str, name: str, **attributes: str | None) -> None:
        """Set attributes of an element; what stood there is kept for undoing. Nothing is touched when it reads the same."""
        for key, value in attributes.items():
            node = self.node(kind, name)
            old = node.attributes.get(key)
            if old == value or (old is not None and value is not None and _same(old, value)):
                continue
            self.undo.append((kind, name, key, old))
            self.xml.set(node, key, value)

    def option(self, **attributes: str) -> None:
        """Set attributes of <option>."""
        if self.xml.root.child("option") is None:
            self._section("option", first=True)
        for key, value in attributes.items():
            node = self.xml.root.child("option")
            assert node is not None
            self.undo.append(("option", "", key, node.attributes.get(key)))
            self.xml.set(node, key, value)

    def add(self, section: str, kind: str, name: str, lines: list[str], *, chain: bool = False) -> None:
        """Add a named element to a section of the file; ``chain`` says that it is part of the chain, else it is an effect's."""
        parent = self._section(section)
        self.xml.append(parent, lines)
        self.added.append((kind, name))
        if not chain:
            self.ignored.append(name)

    def _section(self, tag: str, *, first: bool = False) -> Node:
        node = self.xml.root.child(tag)
        if node is None:
            if first and self.xml.root.children:
                self.xml.insert_before(self.xml.root.children[0], [f"<{tag}/>"])
            else:
                self.xml.append(self.xml.root, [f"<{tag}>", f"</{tag}>"])
            node = self.xml.root.child(tag)
        assert node is not None
        return node

    def fresh(self, kind: str, name: str) -> str:
        """A name that no element of this kind has."""
        taken = {n.attributes.get("name") for n in self.xml.root.walk()}
        while name in taken:
            name += "_"
        return name

    def undo_all(self, undo: list[tuple[str, str, str, str | None]], added: list[tuple[str, str]]) -> None:
        """Take back what an earlier correction wrote."""
        for kind, name, key, old in reversed(undo):
            node = self.xml.root.child("option") if kind == "option" else self.node(kind, name)
            if node is not None and key == "<tag>":
                self.xml.rename(node, str(old))
            elif node is not None:
                self.xml.set(node, key, old)
        for kind, name in reversed(added):
            self.xml.remove(self.node(kind, name))

    # ---- places ---------------------------------------------------------------------------------------------------------

    def joint_of(self, body: int) -> str | None:
        """The joint whose angle is the body's own, or None when it takes several joints."""
        where = np.flatnonzero(self.found.rows[body])
        if len(where) == 1 and self.found.rows[body][where[0]] == 1.0:
            return str(self.model.joint(int(self.model.dof_jntid[where[0]])).name)
        return None

    def tendon(self, name: str, along: np.ndarray, *, chain: bool, **attributes: str) -> None:
        """A fixed tendon over the joints of a row."""
        pairs = [(self.model.joint(int(self.model.dof_jntid[d])).name, float(along[d])) for d in np.flatnonzero(along)]
        joints = ["  " + element("joint", joint=j, coef=number(c)) for j, c in pairs]
        lines = [element("fixed", close=False, name=name, **attributes), *joints, "</fixed>"]
        self.add("tendon", "tendon", name, lines, chain=chain)

    def hold_tendons(self, joint: str) -> None:
        """State the rest length of the tendons over a joint: MuJoCo computes one that is not stated at the joint's springref."""
        for t in np.flatnonzero(self.model.tendon_stiffness):
            name = self.model.tendon(int(t)).name
            node = self.node("tendon", name)
            over = any(n.tag == "joint" and n.attributes.get("joint") == joint for n in node.walk())
            if over and "springlength" not in node.attributes:
                self.set("tendon", name, springlength=row(sorted({float(x) for x in self.model.tendon_lengthspring[t]})))

    def absolute_tendon(self, body: int, what: str, *, chain: bool, **attributes: str) -> None:
        """A tendon along a body's absolute angle."""
        name = self.fresh("tendon", f"{self.chain.bodies[body].joint}_{what}")
        self.tendon(name, self.found.rows[body], chain=chain, **attributes)

    def step(self, largest: float) -> None:
        """Make the timestep no larger than this, a whole fraction of what it is; what follows the timestep is written anew."""
        before = self.timestep
        if before <= largest * (1 + 1e-9):
            return
        self.option(timestep=number(float(f"{before / math.ceil(before / largest - 1e-9):.12g}")))
        for write in self._following:
            write()

    def follow(self, write: Callable[[], None]) -> None:
        """Write something that depends on the timestep, now and whenever that changes."""
        self._following.append(write)
        write()

    @property
    def timestep(self) -> float:
        """Timestep as the file now has it [s]."""
        node = self.xml.root.child("option")
        return float(node.attributes["timestep"]) if node and "timestep" in node.attributes else float(self.model.opt.timestep)

    def degrees(self) -> bool:
        """Whether angles of the chain are degrees in this file."""
        compiler = self.xml.root.child("compiler")
        return self.chain.motion.value == "hinge" and (compiler is None or compiler.attributes.get("angle", "degree") == "degree")

    def general(self) -> str:
        """Turn the bound actuator into the <general> that it stands for, which takes any attribute."""
        name = self.found.layout.drive.name
        node = self.node("actuator", name)
        if node.tag != "general":
            if node.tag != "motor":
                self.set("actuator", name, **spelled_out(self.model, self.found.layout.drive.id, node.attributes))
            self.undo.append(("actuator", name, "<tag>", node.tag))
            self.xml.rename(node, "general")
        return name

    # ---- assets ---------------------------------------------------------------------------------------------------------

    def relocate(self, out: Path) -> None:
        """Keep file references valid when the copy stands in another directory."""
        relocate(self.xml, self.path, out)


def _same(a: str, b: str) -> bool:
    """Whether two attribute texts hold the same numbers."""
    try:
        x, y = [float(v) for v in a.split()], [float(v) for v in b.split()]
    except ValueError:
        return False
    return len(x) == len(y) and all(math.isclose(p, q, rel_tol=1e-13) for p, q in zip(x, y, strict=True))
