"""Slack in MJCF: a limited joint that is free within its range, and a link on one behind its motor."""

from __future__ import annotations

import math

import numpy as np

from mjsim.effects.native import LooseLink
from mjsim.mjcf.editor import MjcfEditor, element, number, row, stiffest
from mjsim.mjcf.linear import LinearWriter

__all__ = ["IMPEDANCE", "NOT_ONE_JOINT", "limit_slack", "loosen_link"]

SLACK_STEP = 5e-5  # largest timestep [s] beside slack (measured, docs/decisions/mjcf.md)
SLACK_ARMATURE = 5e-4  # largest inertia of a free node [kg m^2 | kg], and its part of the lighter body's
SLACK_SHARE = 2e-4
CLOSED = 1e-9  # [rad | m], of a gap that is closed: MuJoCo wants a range that is not empty
IMPEDANCE = "0.9999 0.9999 0.001 0.5 2"
TILT = 1e-9  # [rad], of the added slides: see `_tilted`
NOT_ONE_JOINT = "its angle is not one joint's"


def limit_slack(editor: MjcfEditor, slack: str, width: float, lighter: float, damping: float) -> None:
    """Set the range of a slack joint, its stiff limits, and the inertia of the free node between it and a damper.

    That is little beside the ``lighter`` body's [kg m^2 | kg], and enough for a step of the ``damping`` [N m s/rad | N s/m]
    across it to be stable. ``width``: total gap [rad | m].
    """
    editor.step(SLACK_STEP)
    half = 0.5 * max(width, CLOSED)
    half = math.degrees(half) if editor.degrees() else half
    armature = min(SLACK_ARMATURE, max(SLACK_SHARE * lighter, damping * editor.timestep))
    editor.set("joint", slack, limited="true", range=row([-half, half]), armature=number(armature), solimplimit=IMPEDANCE)
    editor.follow(lambda: editor.set("joint", slack, solreflimit=stiffest(editor.timestep)))


def loosen_link(editor: MjcfEditor, linear: LinearWriter, value: LooseLink) -> str:
    """Hang the link of a body on a gap behind its joint; returns what cannot be written, "" when nothing.

    The joint keeps its friction and its drive, with the motor's inertia as its armature. The body gets two further joints on the
    same axis: the slack one and the spring of the contact.
    """
    joint = editor.joint_of(value.body)
    if joint is None:
        return NOT_ONE_JOINT
    if not any(mass.kind == "body" for mass, _ in editor.found.masses[value.body]):
        return "no body hangs on its joint"
    linear.share(value.body, joint, value.inertia)
    index = editor.model.joint(joint).id
    turns = editor.chain.motion.value == "hinge"
    direction = editor.model.jnt_axis[index] if turns else _tilted(editor.model.jnt_axis[index])
    place, axis = row(list(editor.model.jnt_pos[index])), row(list(direction))
    same = {"type": editor.chain.motion.value, "pos": place, "axis": axis}
    slack, contact = (editor.fresh("joint", f"{joint}_{what}") for what in ("slack", "contact"))
    spring = {"stiffness": number(value.stiffness), "damping": number(value.damping)}
    lines = [element("joint", close=True, name=slack, **same), element("joint", close=True, name=contact, **same, **spring)]
    body = editor.xml.find(lambda n: n.tag == "body" and any(c.attributes.get("name") == joint for c in n.children))
    assert body is not None
    editor.xml.append(body, lines)
    for name in (slack, contact):
        editor.added.append(("joint", name))
        editor.ignored.append(name)
    lighter = min(value.inertia, linear.target.bodies[value.body].inertia - value.inertia)
    limit_slack(editor, slack, value.width, lighter, value.damping)
    return ""


def _tilted(axis: np.ndarray) -> np.ndarray:
    """An axis (3,) turned by `TILT`, so that it lies on no axis of its body.

    MuJoCo takes a body of slides along axes of its frame for a "simple" one, whose inertia matrix is diagonal; of two slides
    along one axis it is not.
    """
    aside = np.zeros(3)
    aside[int(np.argmin(np.abs(axis)))] = TILT
    return axis + aside
