"""Slack in MJCF: a limited joint that is free within its range, and a link on one behind its motor."""

from __future__ import annotations

import math

import mujoco
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

    The joint keeps its friction and its drive, with the motor's inertia as its armature. The body gets a slack joint on the same
    axis, whose soft limits are the contact: beyond the range, by r, MuJoCo's limit of impedance d gives the force
    d m (d K r + B r' - a), no less than 0, with m = J_m J_l / (J_m + J_l) and a the relative acceleration without it. At the
    smallest impedance, d = 1e-4, this is the contact k r + damping r' but for 1e-4 of the force that acts across the gap.
    """
    joint = editor.joint_of(value.body)
    if joint is None:
        return NOT_ONE_JOINT
    if not any(mass.kind == "body" for mass, _ in editor.found.masses[value.body]):
        return "no body hangs on its joint"
    total = linear.target.bodies[value.body].inertia
    linear.share(value.body, joint, value.inertia)
    index = editor.model.joint(joint).id
    turns = editor.chain.motion.value == "hinge"
    direction = editor.model.jnt_axis[index] if turns else _tilted(editor.model.jnt_axis[index])
    place, axis = row(list(editor.model.jnt_pos[index])), row(list(direction))
    half = 0.5 * max(value.width, CLOSED)
    half = math.degrees(half) if editor.degrees() else half
    reduced = (total - value.inertia) * value.inertia / total
    soft = mujoco.mjMINIMP
    slack = editor.fresh("joint", f"{joint}_slack")
    line = element(
        "joint", close=True, name=slack, type=editor.chain.motion.value, pos=place, axis=axis, limited="true",
        range=row([-half, half]), solreflimit=row([-value.stiffness / reduced, -value.damping / reduced]),
        solimplimit=row([soft, soft, 0.001, 0.5, 2]),
    )  # fmt: skip
    body = editor.xml.find(lambda n: n.tag == "body" and any(c.attributes.get("name") == joint for c in n.children))
    assert body is not None
    editor.xml.append(body, [line])
    editor.added.append(("joint", slack))
    editor.ignored.append(slack)
    editor.step(SLACK_STEP)
    return ""


def _tilted(axis: np.ndarray) -> np.ndarray:
    """An axis (3,) turned by `TILT`, so that it lies on no axis of its body.

    MuJoCo takes a body of slides along axes of its frame for a "simple" one, whose inertia matrix is diagonal; of two slides
    along one axis it is not.
    """
    aside = np.zeros(3)
    aside[int(np.argmin(np.abs(axis)))] = TILT
    return axis + aside
