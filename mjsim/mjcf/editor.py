"""The few primitives by which effects write themselves into a copy of an MJCF file, each recorded so that it can be undone."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np

from mjsim.chain import Chain
from mjsim.effects.base import Effect
from mjsim.effects.ports import BacklashLaw
from mjsim.errors import InputError
from mjsim.mjcf.chain import Found, Part
from mjsim.mjcf.layout import Mass
from mjsim.mjcf.xmltext import Node, XmlText
from mjsim.quantity import Motion

__all__ = ["MjcfEditor", "number"]

# largest timestep at which plain MuJoCo meets the law to about 1e-3 (measured, docs/decisions/mjcf-native.md)
FRICTION_STEP = 1e-4
SLACK_STEP = 5e-5
DELAY_STEP = 1e-4
SLACK_ARMATURE = 5e-4
IMPEDANCE = "0.9999 0.9999 0.001 0.5 2"


def number(value: float) -> str:
    """Shortest text that reads back as the same number."""
    text = repr(float(value))
    return text.removesuffix(".0")


def _clean(value: float) -> float:
    """Fifteen digits, without the rounding of the way here."""
    return float(f"{value:.15g}")


def _row(values: list[float] | tuple[float, ...]) -> str:
    return " ".join(number(v) for v in values)


class MjcfEditor:
    """Edits a copy of an authored MJCF whose chain is known.

    ``undo`` lists what was changed, newest last, as (element, attribute, old value or None); ``added`` names elements that were
    added; ``ignored`` those among them (and others) that stand for an effect and are no part of the chain. ``holds``: the effects
    that the file has by MJCF's own elements.
    """

    def __init__(
        self, path: Path, found: Found, target: Chain, law: BacklashLaw = BacklashLaw.GATED, holds: Sequence[Effect] = ()
    ) -> None:
        self.path = path
        self.found = found
        self.target = target
        self.backlash_law = law
        self.xml = XmlText(path.read_text(encoding="utf-8"))
        self.added: list[tuple[str, str]] = []
        self.ignored: list[str] = []
        self.undo: list[tuple[str, str, str, str | None]] = []
        self.holds = {e.key: e for e in holds}
        self._friction: dict[int, float] = {}
        self._offset = -self._pull()
        self._heavier: dict[int, float] = {}
        self._now: dict[int, tuple[float, float]] = {}
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

    # ---- linear parameters ----------------------------------------------------------------------------------------------

    def linear(self) -> None:
        """Write the inertias, viscous frictions, stiffnesses and dampings of the target that differ from the file's."""
        old, new = self.chain, self.target
        for i, (a, b) in enumerate(zip(old.bodies, new.bodies, strict=True)):
            if not math.isclose(a.inertia, b.inertia, rel_tol=1e-12):
                for mass, _ in self.found.masses[i]:
                    self._scale_mass(mass, b.inertia / a.inertia)
            if not math.isclose(a.viscous, b.viscous, rel_tol=1e-12):
                self._passive(list(self.found.on_body[i]), "damping", a.viscous, b.viscous, self._put_on_body(i))
        for j, (c, d) in enumerate(zip(old.couplings, new.couplings, strict=True)):
            parts = list(self.found.on_coupling[j])
            for what in ("stiffness", "damping"):
                before, after = getattr(c, what), getattr(d, what)
                if not math.isclose(before, after, rel_tol=1e-12):
                    self._passive(parts, what, before, after, self._put_on(parts, what))

    def _scale_mass(self, mass: Mass, factor: float) -> None:
        if mass.kind == "body":
            self._scale_body(mass, factor)
        elif mass.kind == "actuator":
            self._scale_armature("actuator", self.found.layout.drive.name, mass, factor)
        else:
            self._scale_armature(mass.kind, mass.name, mass, factor)

    def _scale_armature(self, kind: str, name: str, mass: Mass, factor: float) -> None:
        now = self.node(kind, name).attributes.get("armature")
        self.set(kind, name, armature=number(_clean((float(now) if now else mass.value) * factor)))

    def _scale_body(self, mass: Mass, factor: float) -> None:
        """Scale a body's inertia about its axis: that about its centre when the lever's share allows, else all of it."""
        value, lever = self._now.get(mass.id, (mass.value, mass.lever))
        spin, target = value - lever, factor * value
        alone = 0 <= lever < target and spin > 0  # then the mass and its place stay as they are
        k = (target - lever) / spin if alone else factor
        self._now[mass.id] = (target, lever if alone else factor * lever)
        self._inertial(mass)
        self._scale_attribute(mass, "mass", 1.0 if alone else k)
        if not alone and self.model.opt.gravity.any():  # its weight stays
            self._heavier[mass.id] = k * self._heavier.get(mass.id, 1.0)
            self._weigh(mass, 1.0)
        for key in ("diaginertia", "fullinertia"):
            self._scale_attribute(mass, key, k)

    def _scale_attribute(self, mass: Mass, key: str, factor: float) -> None:
        old = self.node("inertial", mass.name).attributes.get(key)
        if old is not None and factor != 1.0:
            self.set("inertial", mass.name, **{key: _row([_clean(float(v) * factor) for v in old.split()])})

    def _inertial(self, mass: Mass) -> None:
        """Make sure that the body says its inertia itself, and not by its geoms."""
        node = self.node("body", mass.name)
        if node.child("inertial") is not None:
            return
        if self.xml.find(lambda n: n.tag == "compiler" and n.attributes.get("inertiafromgeom") == "true"):
            raise InputError(self.path, f"body {mass.name!r} takes its inertia from geoms", "an <inertial> element", "write one")
        b = mass.id
        text = (
            f'<inertial pos="{_row(list(self.model.body_ipos[b]))}" quat="{_row(list(self.model.body_iquat[b]))}"'
            f' mass="{number(self.model.body_mass[b])}" diaginertia="{_row(list(self.model.body_inertia[b]))}"/>'
        )
        joint = next((c for c in node.children if c.tag == "joint"), None)
        if joint is None:
            self.xml.append(node, [text])
        else:
            self.xml.insert_before(joint, [text])
        self.added.append(("inertial", mass.name))

    def _passive(self, parts: list[Part], what: str, old: float, new: float, otherwise: Callable[[float], None]) -> None:
        """Change a sum over elements: in proportion where there is one, else on the element that stands for the place."""
        holding = [p for p in parts if getattr(p.element, what)[0] != 0]
        if not holding or old == 0:
            otherwise(new)
            return
        for p in holding:
            self._first(p, what, _clean(getattr(p.element, what)[0] * new / old))

    def _first(self, part: Part, what: str, value: float, *more: float) -> None:
        """Write the linear coefficient (and with ``more`` the higher ones) of an element."""
        e = part.element
        higher = more or tuple(getattr(e, what)[1:])
        text = _row([value, *higher]) if any(higher) else number(value)
        self.set(e.kind, e.name, **{what: text})

    def _put_on(self, parts: list[Part], what: str) -> Callable[[float], None]:
        """Write a coupling's number on its first element."""
        return lambda value: self._first(parts[0], what, _clean(value / parts[0].scale ** 2))

    def _put_on_body(self, body: int) -> Callable[[float], None]:
        """Write a body's viscous friction on its joint, or on a tendon along its absolute angle."""

        def put(value: float) -> None:
            joint = self._joint_of(body)
            if joint is not None:
                self.set("joint", joint, damping=number(value))
            else:
                self._absolute_tendon(body, "viscous", chain=True, damping=number(value))

        return put

    # ---- places ---------------------------------------------------------------------------------------------------------

    def _joint_of(self, body: int) -> str | None:
        """The joint whose angle is the body's own, or None when it takes several joints."""
        where = np.flatnonzero(self.found.rows[body])
        if len(where) == 1 and self.found.rows[body][where[0]] == 1.0:
            return str(self.model.joint(int(self.model.dof_jntid[where[0]])).name)
        return None

    def _tendon(self, name: str, row: np.ndarray, *, chain: bool, **attributes: str) -> None:
        """A fixed tendon over the joints of a row."""
        pairs = [(self.model.joint(int(self.model.dof_jntid[d])).name, float(row[d])) for d in np.flatnonzero(row)]
        head = " ".join(f'{k}="{v}"' for k, v in attributes.items())
        lines = [f'<fixed name="{name}" {head}>', *(f'  <joint joint="{j}" coef="{number(c)}"/>' for j, c in pairs), "</fixed>"]
        self.add("tendon", "tendon", name, lines, chain=chain)

    def _absolute_tendon(self, body: int, what: str, *, chain: bool, **attributes: str) -> None:
        """A tendon along a body's absolute angle."""
        name = self.fresh("tendon", f"{self.chain.bodies[body].joint}_{what}")
        self._tendon(name, self.found.rows[body], chain=chain, **attributes)

    def step(self, largest: float) -> None:
        """Make the timestep no larger than this, a whole fraction of what it is; what follows the timestep is written anew."""
        before = self.timestep
        if before <= largest * (1 + 1e-9):
            return
        self.option(timestep=number(float(f"{before / math.ceil(before / largest - 1e-9):.12g}")))
        for write in self._following:
            write()

    def _follow(self, write: Callable[[], None]) -> None:
        """Write something that depends on the timestep, now and whenever that changes."""
        self._following.append(write)
        write()

    @property
    def timestep(self) -> float:
        """Timestep as the file now has it [s]."""
        node = self.xml.root.child("option")
        return float(node.attributes["timestep"]) if node and "timestep" in node.attributes else float(self.model.opt.timestep)

    # ---- effects --------------------------------------------------------------------------------------------------------

    def weight(self, factor: float) -> None:
        """Weight of the last body, over that which it has in the file."""
        for mass, _ in self.found.masses[-1]:
            if mass.kind == "body":
                self._weigh(mass, factor)

    def _weigh(self, mass: Mass, factor: float) -> None:
        """Gravity compensation takes off, or adds, what a body weighs too much or too little."""
        left = factor / self._heavier.get(mass.id, 1.0)
        self.set("body", mass.name, gravcomp=number(_clean(1.0 - left)) if left != 1.0 else None)

    def _pull(self) -> float:
        """Part of the constant torque on the driven body that no actuator gives: a weight along a slide."""
        drive, own = self.found.layout.drive, self.holds.get("torque_offset@motor")
        bias = float(self.model.actuator_biasprm[drive.id, 0]) * self.chain.gain / drive.gain
        return own.values["torque_Nm"] - bias if own is not None else 0.0

    def friction(self, body: int, level: float) -> None:
        """Dry friction of a body against the ground [N m | N]: frictionloss that sticks. Levels at one body add up."""
        self._friction[body] = self._friction.get(body, 0.0) + level
        self.step(FRICTION_STEP)
        self._follow(lambda: self._write_friction(body, self._friction[body]))

    def _write_friction(self, body: int, level: float) -> None:
        runge_kutta = int(self.model.opt.integrator) == mujoco.mjtIntegrator.mjINT_RK4
        rate = (2.5 if runge_kutta else 1.0) / self.timestep
        attributes = {
            "frictionloss": number(level),
            "solreffriction": f"-1 {number(-float(f'{rate:.6g}'))}",
            "solimpfriction": IMPEDANCE,
        }
        joint = self._joint_of(body)
        for part in self.found.on_body[body]:  # what the file has elsewhere is in the level
            if part.element.friction and (part.element.kind, part.element.name) != ("joint", joint):
                self.set(part.element.kind, part.element.name, frictionloss="0")
        if joint is not None:
            self.set("joint", joint, **attributes)
            return
        name = f"{self.chain.bodies[body].joint}_friction"
        if ("tendon", name) in self.added:
            for key, value in attributes.items():
                self.xml.set(self.node("tendon", name), key, value)
        else:
            self._absolute_tendon(body, "friction", chain=False, **attributes)

    def viscous(self, body: int, coefficient: float) -> None:
        """Viscous friction of a body against the ground, where the model has none."""
        self._absolute_tendon(body, "viscous", chain=False, damping=number(coefficient))

    def drag(self, body: int, coefficient: float) -> bool:
        """Damping c v |v| on a body whose angle is a joint's; False when it is not."""
        joint = self._joint_of(body)
        if joint is None:
            return False
        now = self.node("joint", joint).attributes.get("damping")
        dof = int(self.model.jnt_dofadr[self.model.joint(joint).id])
        linear = float(now.split()[0]) if now else float(self.model.dof_damping[dof])
        self.set("joint", joint, damping=_row([linear, coefficient]))
        return True

    def gap(self, coupling: int, width: float) -> None:
        """A gap [rad | m] in a coupling: range of its slack joint when it has one, else a dead band in place of its spring."""
        slack = self._slack_joint(coupling)
        if slack is None:
            self._dead_band(coupling, width)
            return
        self.step(SLACK_STEP)
        half = math.degrees(0.5 * width) if self._degrees() else 0.5 * width
        span = f"{number(-half)} {number(half)}"
        self.set("joint", slack, limited="true", range=span, armature=number(SLACK_ARMATURE), solimplimit=IMPEDANCE)
        self._follow(lambda: self.set("joint", slack, solreflimit=_stiffest(self.timestep)))
        for e in range(self.model.neq):
            holds = (
                int(self.model.eq_type[e]) == mujoco.mjtEq.mjEQ_JOINT
                and int(self.model.eq_obj2id[e]) < 0
                and self.model.joint(int(self.model.eq_obj1id[e])).name == slack
            )
            if holds:
                self.set("equality", self.model.equality(e).name, active="false")

    def _degrees(self) -> bool:
        compiler = self.xml.root.child("compiler")
        return self.chain.motion.value == "hinge" and (compiler is None or compiler.attributes.get("angle", "degree") == "degree")

    def _slack_joint(self, coupling: int) -> str | None:
        """A joint of the file that is nothing but slack of this coupling, open or held."""
        for kind, joint, _ in self.found.gaps[coupling]:
            if kind == "joint":
                return str(self.model.joint(joint).name)
        c = self.chain.couplings[coupling]
        row = c.ratio * self.found.rows[coupling] - self.found.rows[coupling + 1]
        used = {
            p.element.id for p in (*sum(self.found.on_coupling, ()), *sum(self.found.on_body, ())) if p.element.kind == "joint"
        }
        for j in range(self.model.njnt):
            dof = int(self.model.jnt_dofadr[j])
            held = not np.any(self.found.layout.base[dof])
            if held and self.model.jnt_limited[j] and j not in used and abs(abs(float(row[dof])) - 1.0) < 1e-9:
                return str(self.model.joint(j).name)
        return None

    def _dead_band(self, coupling: int, width: float) -> None:
        parts = [p for p in self.found.on_coupling[coupling] if p.element.stiffness[0]]
        if len(parts) != 1:
            raise InputError(self.path, f"{self.chain.couplings[coupling].joint!r} has {len(parts)} springs", "one", "merge them")
        part = parts[0]
        half = 0.5 * width * abs(part.scale)
        span = f"{number(-half)} {number(half)}"
        if part.element.kind == "tendon":
            rest = 0.5 * float(np.sum(self.model.tendon_lengthspring[part.element.id]))
            self.set("tendon", part.element.name, springlength=f"{number(rest - half)} {number(rest + half)}")
            return
        node = self.node("joint", part.element.name)
        stiffness = node.attributes.get("stiffness") or number(part.element.stiffness[0])
        self.set("joint", part.element.name, stiffness="0")
        name = self.fresh("tendon", f"{part.element.name}_spring")
        self._tendon(name, part.element.row, chain=True, stiffness=stiffness, springlength=span)

    def cubic(self, coupling: int, coefficient: float) -> bool:
        """A cubic term beside the spring of a coupling; False when no one element carries the spring."""
        parts = [p for p in self.found.on_coupling[coupling] if p.element.stiffness[0]]
        if len(parts) != 1:
            return False
        p = parts[0]
        kind, name = p.element.kind, p.element.name
        moved = next((n for k, n in self.added if k == "tendon" and n.rstrip("_") == f"{name}_spring"), None)
        if moved is not None:
            kind, name = "tendon", moved
        now = self.node(kind, name).attributes.get("stiffness")
        linear = float(now.split()[0]) if now else p.element.stiffness[0]
        self.set(kind, name, stiffness=_row([linear, 0.0, coefficient / p.scale**4]))
        return True

    def bristle_coupling(self, coupling: int, torque: float, stiffness: float) -> None:
        """A yielding bristle beside the spring of a coupling, in the coupling's own units [N m, N m/rad | N, N/m]."""
        p = next((p for p in self.found.on_coupling[coupling] if p.element.stiffness[0]), self.found.on_coupling[coupling][0])
        where, target = p.element.kind, p.element.name
        if where == "actuator":
            target = self.fresh("tendon", f"{self.chain.couplings[coupling].joint}_across")
            where = "tendon"
            self._tendon(target, p.element.row, chain=False)
        level = torque / abs(p.scale)
        lugre = (stiffness / p.scale**2, 0.0, level, level, 1.0)
        self._bristle(f"{self.chain.couplings[coupling].joint}_hysteresis", where, target, lugre)

    def bristle_body(
        self, body: int, torque: float, stiffness: float, damping: float = 0.0, extra: float = 0.0, speed: float = 1.0
    ) -> bool:
        """A yielding bristle between a body and the ground; False when the body's angle is not one joint's.

        ``extra``: level at rest above ``torque``, which fades over ``speed``.
        """
        joint = self._joint_of(body)
        if joint is None:
            return False
        self._bristle(f"{joint}_bristle", "joint", joint, (stiffness, damping, torque, torque + extra, speed))
        return True

    def _bristle(self, name: str, where: str, target: str, lugre: tuple[float, float, float, float, float]) -> None:
        # stiffness, damping, levels at speed and at rest, Stribeck velocity, which does nothing where the levels are one
        self.step(FRICTION_STEP)
        self._passive_motor(name, where, target, lugre=lugre)

    def split(self, body: int, inertia: float, stiffness: float, damping: float) -> bool:
        """Hang part of a body's inertia on a further joint below it; False when the body has no joint of its own."""
        heavy = max((m for m, _ in self.found.masses[body] if m.kind == "body"), key=lambda m: m.value)
        if not heavy.name or not self.model.body_jntnum[heavy.id]:
            return False
        total = self.target.bodies[body].inertia
        for mass, _ in self.found.masses[body]:
            self._scale_mass(mass, 1.0 - inertia / total)
        joint = int(self.model.body_jntadr[heavy.id])
        name = self.fresh("body", f"{self.chain.bodies[body].joint}_extra")
        place, axis = (_row(list(v[joint])) for v in (self.model.jnt_pos, self.model.jnt_axis))
        slide = self.chain.motion is Motion.SLIDE
        weight, tensor = (inertia, 1.0) if slide else (1.0, inertia)
        lines = [
            f'<body name="{name}">',
            f'  <joint name="{name}" type="{self.chain.motion.value}" pos="{place}" axis="{axis}"'
            f' stiffness="{number(stiffness)}" damping="{number(damping)}"/>',
            f'  <inertial pos="{place}" mass="{number(weight)}" diaginertia="{_row([tensor] * 3)}"/>',
            "</body>",
        ]
        self.xml.append(self.node("body", heavy.name), lines)
        self.added.append(("body", name))
        self.ignored.append(name)
        return True

    # ---- actuator and sensors -------------------------------------------------------------------------------------------

    def _general(self) -> str:
        """Turn the bound <motor> into the <general> that it stands for, which takes any attribute."""
        name = self.found.layout.drive.name
        node = self.node("actuator", name)
        if node.tag != "general":
            self.undo.append(("actuator", name, "<tag>", node.tag))
            self.xml.rename(node, "general")
        return name

    def limit_input(self, limit: float) -> None:
        """Saturation of the command [unit of the input]."""
        name = self.found.layout.drive.name
        self.set("actuator", name, ctrllimited="true", ctrlrange=f"{number(-limit)} {number(limit)}")

    def lag_input(self, time_constant: float) -> None:
        """First-order lag of the command [s]."""
        if time_constant > 0:
            self.set("actuator", self._general(), dyntype="filter", dynprm=number(time_constant))

    def delay_input(self, delay: float) -> None:
        """Delay of the command [s], in whole steps."""
        if delay > 0:
            self.step(DELAY_STEP)
            self._follow(lambda: self._delay("actuator", self.found.layout.drive.name, delay))

    def _delay(self, kind: str, name: str, delay: float, **more: str) -> None:
        self.set(kind, name, delay=number(delay), nsample=str(math.ceil(delay / self.timestep - 1e-9) + 1), **more)

    def offset(self, torque: float) -> None:
        """Constant torque on the driven body [N m | N], positive drives forward; offsets add up."""
        self._offset += torque
        drive = self.found.layout.drive
        bias = self._offset * drive.gain / self.chain.gain
        self.set("actuator", self._general(), biastype="affine", biasprm=f"{number(bias)} 0 0")

    def delay_output(self, delay: float) -> bool:
        """Delay of the bound sensors [s], in whole steps; False when there is none."""
        names = {self.chain.velocity_sensor, self.chain.angle_sensor} & {
            self.model.sensor(s).name for s in range(self.model.nsensor)
        }
        for name in sorted(names):
            self._follow(lambda name=name: self._delay("sensor", name, delay, interp="linear"))  # type: ignore[misc]
        return bool(names)

    def cogging(self, amplitude: float, cycles: int, phase: float) -> bool:
        """Torque amplitude sin(cycles angle + phase) on the driven body; False when its angle is not one joint's."""
        joint = self._joint_of(0)
        if joint is None:
            return False
        self._passive_motor(f"{joint}_cogging", "joint", joint, cogging=(amplitude, float(cycles), phase))
        return True

    def _passive_motor(self, name: str, where: str, target: str, **attributes: tuple[float, ...]) -> None:
        """A <dcmotor> without input or electric part."""
        name = self.fresh("actuator", name)
        extra = " ".join(f'{k}="{_row(v)}"' for k, v in attributes.items())
        line = f'<dcmotor name="{name}" {where}="{target}" input="none" resistance="1" motorconst="0 0" {extra}/>'
        self.add("actuator", "actuator", name, [line])

    # ---- assets ---------------------------------------------------------------------------------------------------------

    def relocate(self, out: Path) -> None:
        """Keep file references valid when the copy stands in another directory."""
        here, there = self.path.resolve().parent, out.resolve().parent
        if here == there:
            return
        relative = Path(os.path.relpath(here, there))
        refers = [n for n in self.xml.root.walk() if "file" in n.attributes]
        for include in [n for n in refers if n.tag == "include"]:
            self.xml.set(include, "file", str(relative / include.attributes["file"]))
        if any(n.tag != "include" for n in refers):
            self._section("compiler", first=True)
            for key in ("assetdir", "meshdir", "texturedir"):
                compiler = self.xml.root.child("compiler")
                assert compiler is not None
                if key == "assetdir" or key in compiler.attributes:
                    self.xml.set(compiler, key, str(relative / compiler.attributes.get(key, ".")))


def _stiffest(timestep: float) -> str:
    """solref of a limit that is critically damped and as stiff as the step allows."""
    return f"{number(-float(f'{1 / timestep**2:.6g}'))} {number(-float(f'{2 / timestep:.6g}'))}"


def _same(a: str, b: str) -> bool:
    """Whether two attribute texts hold the same numbers."""
    try:
        x, y = [float(v) for v in a.split()], [float(v) for v in b.split()]
    except ValueError:
        return False
    return len(x) == len(y) and all(math.isclose(p, q, rel_tol=1e-13) for p, q in zip(x, y, strict=True))
