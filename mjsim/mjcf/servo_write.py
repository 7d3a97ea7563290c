"""Writes the drive into a copy of an MJCF: a servo as the ``<general>`` that it stands for; a ``<pid>`` keeps its inputs."""

from __future__ import annotations

import math

from mjsim.mjcf.drive_laws import IMAX
from mjsim.mjcf.editor import MjcfEditor, number, row
from mjsim.mjcf.servo import bias_of
from mjsim.servo import Servo, Target

__all__ = ["write_force", "write_integral", "write_lag", "write_servo", "write_slew"]

NO_FILTER = "a <pid> with several inputs, slewmax or ki has no filter of its command"
NO_INTEGRAL = "only a servo whose command is its position can be a <pid>, which has integral action"
NO_SLEW = "only a servo whose command is its position can be a <pid>, which has such a limit"


def write_servo(editor: MjcfEditor, new: Servo | None) -> None:
    """Write gains, zero and force limit of a servo where they differ from the file's, as a ``<general>``."""
    old = editor.chain.servo
    if new is None or old == new:
        return
    name = editor.general()
    law = editor.found.layout.drive.law
    bias = (law.constant, -new.kp, -new.kv) if law.integral else bias_of(new)
    editor.set("actuator", name, biastype="affine", biasprm=row(bias))
    if not _is_pid(editor, name):  # whose gain is that of its bias
        editor.set("actuator", name, gaintype="fixed", gainprm=number(new.gain))
    if old is not None and new.limit != old.limit:
        editor.set("actuator", name, forcelimited="true", forcerange=f"{number(-new.limit)} {number(new.limit)}")


def write_force(editor: MjcfEditor, servo: Servo | None, force: float) -> None:
    """Write a constant force of the actuator beside a servo's law [N m | N]; of integral action it is a part of its start."""
    if servo is None or not force:
        return
    name = editor.general()
    node = editor.node("actuator", name)
    if not (_is_pid(editor, name) and float(node.attributes.get("gainprm", "0").split()[0])):
        editor.set("actuator", name, biastype="affine", biasprm=row(bias_of(servo, force)))


def write_lag(editor: MjcfEditor, servo: Servo | None, time_constant: float) -> str:
    """Write a filter [s] of the command, a ``<pid>`` of one setpoint as the same law of fixed gain; what MuJoCo lacks of it."""
    drive = editor.found.layout.drive
    if math.isfinite(drive.law.slew) or editor.node("actuator", drive.name).attributes.get("dyntype") == "pid":
        return NO_FILTER
    if len(drive.law.inputs) > 1:
        return NO_FILTER
    name = editor.general()
    if _is_pid(editor, name) and servo is not None:
        span = row([servo.low, servo.high]) if math.isfinite(servo.low) else None
        editor.set("actuator", name, gaintype="fixed", gainprm=number(servo.gain), velrange=None, ctrlrange=span)
    editor.set("actuator", name, dyntype="filter", dynprm=number(time_constant))
    return ""


def write_slew(editor: MjcfEditor, servo: Servo | None, limit: float) -> str:
    """Write the largest speed [rad/s | m/s] of the setpoint, as slewmax of a ``<pid>``; what MuJoCo lacks of it."""
    if servo is None or servo.target is not Target.POSITION or servo.scale != 1.0:
        return NO_SLEW
    drive, name = editor.found.layout.drive, editor.general()
    if editor.node("actuator", name).attributes.get("dyntype") in ("filter", "filterexact"):
        return NO_FILTER
    imax = float(editor.model.actuator_dynprm[drive.id, IMAX]) if drive.law.inputs else 0.0
    editor.set("actuator", name, dyntype="pid", dynprm=row([imax, limit]))
    if not _is_pid(editor, name):
        editor.set("actuator", name, gaintype="pid", gainprm="0", input="pos")
    return ""


def write_integral(editor: MjcfEditor, servo: Servo | None, gain: float) -> str:
    """Write the gain [N m/(rad s) | N/(m s)] of integral action, as ki of a ``<pid>``; what MuJoCo lacks of it.

    Its integral is of the command less the length: the zero of the servo is left out.
    """
    if servo is None or servo.target is not Target.POSITION or servo.scale != 1.0:
        return NO_INTEGRAL
    drive, name = editor.found.layout.drive, editor.general()
    node = editor.node("actuator", name)
    if node.attributes.get("dyntype") in ("filter", "filterexact"):
        return NO_FILTER
    slew = float(node.attributes["dynprm"].split()[1]) if node.attributes.get("dyntype") == "pid" else 0.0
    if not _is_pid(editor, name):
        editor.set("actuator", name, gaintype="pid", input="pos")
    constant = drive.law.constant if drive.law.integral else 0.0
    editor.set("actuator", name, biastype="affine", biasprm=row((constant, -servo.kp, -servo.kv)), gainprm=number(gain),
               dyntype="pid" if gain or slew else "none", dynprm=row((0.0, slew)))  # fmt: skip
    return ""


def _is_pid(editor: MjcfEditor, name: str) -> bool:
    return editor.node("actuator", name).attributes.get("gaintype") == "pid"
