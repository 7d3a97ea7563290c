"""Writing the linear parameters: inertias, viscous frictions, stiffnesses, dampings, and the weight that goes with a mass.

A hinge body of mass m, whose centre stands at r from the axis, has the inertia I = S + m r^2 about it (S: about its centre) and
the weight torque m g r. Both are free of each other: with the mass times a, the centre at b r and the inertia about the centre
scaled to S' = I' - a b^2 m r^2, the inertia is I' and the weight a b times what it was, for any a b as long as S' > 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.chain import Chain
from mjsim.errors import InputError
from mjsim.mjcf.chain import Part
from mjsim.mjcf.editor import MjcfEditor, element, number, row
from mjsim.mjcf.layout import Mass
from mjsim.quantity import Motion

__all__ = ["LinearWriter", "rounded"]

LIGHTEST = 0.1  # share of its mass that a body keeps while its weight goes to zero: MuJoCo refuses a moving body without mass
INERTIA = ("diaginertia", "fullinertia")


def rounded(value: float) -> float:
    """Fifteen digits, without the rounding of the way here."""
    return float(f"{value:.15g}")


@dataclass
class _Change:
    """What a mass is to become: its inertia, its weight (over the file's) and the turn [rad] of its centre about the axis."""

    inertia: float = 1.0
    weight: float = 1.0
    turn: float = 0.0


@dataclass(frozen=True)
class _Form:
    """Factors on the mass, on the distance of its centre from the axis and on the inertia about its centre."""

    mass: float
    centre: float
    spin: float


class LinearWriter:
    """Writes the linear parameters of a target chain through an editor; ``weighed``: whether masses have weight in the file."""

    def __init__(self, editor: MjcfEditor, target: Chain) -> None:
        self.editor = editor
        self.target = target
        self.weighed = bool(editor.model.opt.gravity.any())
        self._changes: dict[int, _Change] = {}
        self._authored: dict[int, dict[str, str]] = {}

    def write(self) -> None:
        """Write what differs from the file."""
        old, found = self.editor.chain, self.editor.found
        for i, (a, b) in enumerate(zip(old.bodies, self.target.bodies, strict=True)):
            if not math.isclose(a.inertia, b.inertia, rel_tol=1e-12):
                self.scale(i, b.inertia / a.inertia)
            if not math.isclose(a.viscous, b.viscous, rel_tol=1e-12):
                self._passive(list(found.on_body[i]), "damping", a.viscous, b.viscous, self._put_on_body(i))
        for j, (c, d) in enumerate(zip(old.couplings, self.target.couplings, strict=True)):
            parts = list(found.on_coupling[j])
            for what in ("stiffness", "damping"):
                before, after = getattr(c, what), getattr(d, what)
                if not math.isclose(before, after, rel_tol=1e-12):
                    self._passive(parts, what, before, after, self._put_on(parts, what))

    # ---- inertia and weight -------------------------------------------------------------------------------------------------

    def scale(self, body: int, factor: float) -> None:
        """Scale all inertias of a body of the chain; their weights stay."""
        for mass, _ in self.editor.found.masses[body]:
            if mass.kind == "body":
                self._change(mass).inertia *= factor
                self._write_mass(mass)
            else:
                now = self.editor.node(mass.kind, mass.name).attributes.get("armature")
                self.editor.set(mass.kind, mass.name, armature=number(rounded((float(now) if now else mass.value) * factor)))

    def share(self, body: int, joint: str, link: float) -> None:
        """Set the inertia of a body's masses about its axis to ``link``, and the armature of its joint to the rest of it."""
        masses = self.editor.found.masses[body]
        present = sum(m.value * scale**2 for m, scale in masses if m.kind == "body")
        for mass, _ in masses:
            if mass.kind == "body":
                self._change(mass).inertia = link / present
                self._write_mass(mass)
            elif (mass.kind, mass.name) != ("joint", joint):
                self.editor.set(mass.kind, mass.name, armature="0")
        self.editor.set("joint", joint, armature=number(rounded(self.target.bodies[body].inertia - link)))

    def weigh(self, body: int, factor: float, turn: float) -> None:
        """Scale the weight of a body of a hinge chain and turn its centre by an angle [rad] about the axis; its inertia stays."""
        for mass, scale in self.editor.found.masses[body]:
            if mass.kind == "body" and mass.lever > 0:
                change = self._change(mass)
                change.weight = factor
                change.turn = math.copysign(turn, turn * scale)
                self._write_mass(mass)

    def _change(self, mass: Mass) -> _Change:
        return self._changes.setdefault(mass.id, _Change())

    def _write_mass(self, mass: Mass) -> None:
        change = self._changes[mass.id]
        form = self._form(mass, change)
        self._inertial(mass)
        authored = self._authored[mass.id]
        self._factor(mass, authored, "mass", form.mass)
        for key in INERTIA:
            self._factor(mass, authored, key, form.spin)
        moved = form.centre != 1.0 or change.turn != 0.0
        self.editor.set(
            "inertial", mass.name, pos=row(self._centre(mass, form.centre, change.turn)) if moved else authored["pos"]
        )

    def _form(self, mass: Mass, change: _Change) -> _Form:
        lever, spin = mass.lever, mass.value - mass.lever
        inertia = change.inertia * mass.value
        weighs = self.editor.chain.motion is Motion.HINGE and lever > 0 and self.weighed
        if not weighs:
            alone = 0 <= lever < inertia and spin > 0
            return _Form(1.0, 1.0, (inertia - lever) / spin) if alone else _Form(change.inertia, 1.0, change.inertia)
        heavier = max(change.weight, LIGHTEST)
        nearer = change.weight / heavier
        rest = inertia - lever * change.weight * nearer
        if rest > 0:
            return _Form(heavier, nearer, rest / spin)
        # too heavy for its inertia where its centre stands: nearer to the axis, the shares of mass and centre as they were
        nearer = change.inertia / change.weight
        return _Form(change.weight / nearer, nearer, change.inertia)

    def _centre(self, mass: Mass, factor: float, turn: float) -> list[float]:
        """Centre of a body [m] in its own frame, at a factor of its distance from the axis and turned about it."""
        model = self.editor.model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        joint = int(model.dof_jntid[np.flatnonzero(mass.row)[-1]])
        anchor, axis = data.xanchor[joint], data.xaxis[joint]
        arm = data.xipos[mass.id] - anchor
        along = axis * float(axis @ arm)
        off = arm - along
        off = factor * (math.cos(turn) * off + math.sin(turn) * np.cross(axis, off))
        frame = data.xmat[mass.id].reshape(3, 3)
        return [rounded(v) for v in frame.T @ (anchor + along + off - data.xpos[mass.id])]

    def _factor(self, mass: Mass, authored: dict[str, str], key: str, factor: float) -> None:
        old = authored.get(key)
        if old is not None:
            text = old if factor == 1.0 else row([rounded(float(v) * factor) for v in old.split()])
            self.editor.set("inertial", mass.name, **{key: text})

    def _inertial(self, mass: Mass) -> None:
        """Make sure that the body says its inertia itself, and not by its geoms; keep what its author wrote."""
        if mass.id in self._authored:
            return
        editor, model, b = self.editor, self.editor.model, mass.id
        node = editor.node("body", mass.name)
        if node.child("inertial") is None:
            if editor.xml.find(lambda n: n.tag == "compiler" and n.attributes.get("inertiafromgeom") == "true"):
                raise InputError(
                    editor.path, f"body {mass.name!r} takes its inertia from geoms", "an <inertial> element", "write one"
                )
            text = element(
                "inertial", pos=row(model.body_ipos[b]), quat=row(model.body_iquat[b]), mass=number(model.body_mass[b]),
                diaginertia=row(model.body_inertia[b]),
            )  # fmt: skip
            joint = next((c for c in node.children if c.tag == "joint"), None)
            if joint is None:
                editor.xml.append(node, [text])
            else:
                editor.xml.insert_before(joint, [text])
            editor.added.append(("inertial", mass.name))
        self._authored[mass.id] = dict(editor.node("inertial", mass.name).attributes)

    # ---- springs and dampers ------------------------------------------------------------------------------------------------

    def _passive(self, parts: list[Part], what: str, old: float, new: float, otherwise: Callable[[float], None]) -> None:
        """Change a sum over elements: in proportion where there is one, else on the element that stands for the place."""
        holding = [p for p in parts if getattr(p.element, what)[0] != 0]
        if not holding or old == 0:
            otherwise(new)
            return
        for p in holding:
            self._first(p, what, rounded(getattr(p.element, what)[0] * new / old))

    def _first(self, part: Part, what: str, value: float) -> None:
        """Write the linear coefficient of an element; the higher ones stay."""
        e = part.element
        higher = tuple(getattr(e, what)[1:])
        text = row([value, *higher]) if any(higher) else number(value)
        self.editor.set(e.kind, e.name, **{what: text})

    def _put_on(self, parts: list[Part], what: str) -> Callable[[float], None]:
        """Write a coupling's number on its first element."""
        return lambda value: self._first(parts[0], what, rounded(value / parts[0].scale ** 2))

    def _put_on_body(self, body: int) -> Callable[[float], None]:
        """Write a body's viscous friction on its joint, or on a tendon along its absolute angle."""

        def put(value: float) -> None:
            joint = self.editor.joint_of(body)
            if joint is not None:
                self.editor.set("joint", joint, damping=number(value))
            else:
                self.editor.absolute_tendon(body, "viscous", chain=True, damping=number(value))

        return put
