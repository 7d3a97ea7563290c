"""Writes the drive into a copy of an MJCF: a servo as the ``<general>`` that it stands for.

A ``<pid>`` keeps its inputs. A ``<dcmotor>`` is changed in its own numbers: K = kv / gain and R = K / gain of a motor by its
voltage, the gains of its controller, and Vmax = K V, R = K Vmax / T of a stall torque T and a no-load speed V. Where it has
cogging, a bristle or a Vmax it has no place for a constant torque or a filter; else it becomes a ``<general>`` that has.
"""

from __future__ import annotations

import math

from mjsim.mjcf.drive_laws import CONTROLLER, IMAX, Form, controller_of, electric_of, has_more
from mjsim.mjcf.editor import MjcfEditor, number, row
from mjsim.mjcf.servo import bias_of
from mjsim.servo import Servo, Target

__all__ = [
    "STAYS", "can_be_general", "write_force", "write_integral", "write_lag", "write_limit", "write_line", "write_servo",
    "write_slew",
]  # fmt: skip

KP, KI, KD, SLEW, VMAX = (CONTROLLER.index(x) for x in ("kp", "ki", "kd", "slewmax", "Vmax"))
NO_FILTER = "a <pid> with several inputs, slewmax or ki has no filter of its command"
NO_INTEGRAL = "only a servo whose command is its position can be a <pid>, which has integral action"
NO_SLEW = "only a servo whose command is its position can be a <pid>, which has such a limit"
NO_LINE = "only the controller of a <dcmotor> has such a limit, and no constant torque or filter beside it"
STAYS = "a <dcmotor> with cogging, a bristle or Vmax has no constant torque and no filter"


def write_servo(editor: MjcfEditor, new: Servo | None) -> None:
    """Write gains, zero and force limit of a servo where they differ from the file's."""
    old, drive = editor.chain.servo, editor.found.layout.drive
    if new is None or old == new:
        return
    if drive.law.form is not Form.DCMOTOR or new.zero:
        _as_general(editor, new)
    elif new.back_emf and drive.law.inputs == ("voltage",):
        constant = new.kv / new.gain
        editor.set("actuator", drive.name, nominal=None, motorconst=number(constant), resistance=number(constant / new.gain))
    else:
        _control(editor, {KP: new.kp, KD: new.kv})
    if old is not None and new.limit != old.limit:
        write_limit(editor, new.limit)


def write_force(editor: MjcfEditor, servo: Servo | None, force: float) -> None:
    """Write a constant force of the actuator beside a servo's law [N m | N]; of integral action it is a part of its start."""
    if servo is not None and force:
        _as_general(editor, servo, force)


def _as_general(editor: MjcfEditor, servo: Servo, offset: float = 0.0) -> str:
    """Let the drive be the ``<general>`` of a servo, with a constant force beside its own; the name of the actuator."""
    law, now = editor.found.layout.drive.law, _controller(editor) if _is_motor(editor) else None
    name = editor.general()
    if now is not None and (now[SLEW] or now[KI]):
        editor.set("actuator", name, input=" ".join(law.inputs), gaintype="pid", gainprm=number(now[KI]),
                   dyntype="pid", dynprm=row([0.0, now[SLEW]]))  # fmt: skip
    if now is not None and math.isfinite(servo.limit):
        write_limit(editor, servo.limit)
    pid = _is_pid(editor, name)
    if pid and float(editor.node("actuator", name).attributes.get("gainprm", number(law.integral)).split()[0]):
        bias = (law.constant if law.integral else 0.0, -servo.kp, -servo.kv)
    else:
        bias = bias_of(servo, offset)
    editor.set("actuator", name, biastype="affine", biasprm=row(bias))
    if not pid:  # whose gain is that of its bias
        editor.set("actuator", name, gaintype="fixed", gainprm=number(servo.gain))
    return name


def can_be_general(editor: MjcfEditor) -> bool:
    """Whether a ``<general>`` can take the place of the drive as it stands."""
    drive = editor.found.layout.drive
    return not _is_motor(editor) or not (has_more(editor.model, drive.id) or _controller(editor)[VMAX] > 0)


def write_limit(editor: MjcfEditor, limit: float) -> None:
    """Write a symmetric limit of the input of a torque drive, or of the force of a servo."""
    drive = editor.found.layout.drive
    if _is_motor(editor):
        editor.set("actuator", drive.name, saturation=row([limit, 0.0, 0.0]))
        return
    what = "ctrl" if editor.chain.servo is None else "force"
    name = editor.general() if what == "ctrl" and drive.law.inputs else drive.name
    editor.set("actuator", name, **{f"{what}limited": "true", f"{what}range": row([-limit, limit])})


def write_lag(editor: MjcfEditor, servo: Servo | None, time_constant: float) -> str:
    """Write a filter [s] of the command, a ``<pid>`` of one setpoint as the same law of fixed gain; what MuJoCo lacks of it."""
    drive = editor.found.layout.drive
    if not can_be_general(editor):
        return STAYS
    now = _controller(editor) if _is_motor(editor) else None
    states = math.isfinite(drive.law.slew) or editor.node("actuator", drive.name).attributes.get("dyntype") == "pid"
    if states or drive.law.integral or len(drive.law.inputs) > 1 or (now is not None and (now[SLEW] or now[KI])):
        return NO_FILTER
    name = editor.general() if servo is None or now is None else _as_general(editor, servo)
    if _is_pid(editor, name) and servo is not None:
        span = row([servo.low, servo.high]) if math.isfinite(servo.low) else None
        editor.set("actuator", name, gaintype="fixed", gainprm=number(servo.gain), velrange=None, ctrlrange=span)
    editor.set("actuator", name, dyntype="filter", dynprm=number(time_constant))
    return ""


def write_slew(editor: MjcfEditor, servo: Servo | None, limit: float) -> str:
    """Write the largest speed [rad/s | m/s] of the setpoint, as slewmax of a ``<pid>`` or ``<dcmotor>``; what is lacking."""
    if servo is None or servo.target is not Target.POSITION or servo.scale != 1.0:
        return NO_SLEW
    if _is_motor(editor):
        _control(editor, {SLEW: limit})
        return ""
    name = editor.general()
    node = editor.node("actuator", name)
    if node.attributes.get("dyntype") in ("filter", "filterexact"):
        return NO_FILTER
    imax = node.attributes.get("dynprm", "0").split()[IMAX] if _is_pid(editor, name) else "0"
    editor.set("actuator", name, dyntype="pid", dynprm=f"{imax} {number(limit)}")
    if not _is_pid(editor, name):
        editor.set("actuator", name, gaintype="pid", gainprm="0", input="pos")
    return ""


def write_integral(editor: MjcfEditor, servo: Servo | None, gain: float) -> str:
    """Write the gain [N m/(rad s) | N/(m s)] of integral action, as ki of a ``<pid>`` or ``<dcmotor>``; what is lacking.

    Its integral is of the command less the length: the zero of the servo is left out.
    """
    if servo is None or servo.target is not Target.POSITION or servo.scale != 1.0:
        return NO_INTEGRAL
    if _is_motor(editor):
        _control(editor, {KI: gain})
        return ""
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


def write_line(editor: MjcfEditor, stall: float, no_load: float) -> str:
    """Write the force at rest [N m | N] and the speed without force [rad/s | m/s] of a controller; what MuJoCo lacks of it."""
    drive = editor.found.layout.drive
    if not _is_motor(editor) or drive.law.inputs == ("voltage",):
        return NO_LINE
    constant = electric_of(editor.model, drive.id)[1]
    most = constant * no_load
    editor.set("actuator", drive.name, nominal=None, motorconst=number(constant), resistance=number(constant * most / stall))
    _control(editor, {VMAX: most})
    return ""


def _control(editor: MjcfEditor, values: dict[int, float]) -> None:
    """Change numbers of the controller of a ``<dcmotor>``, by their place in it."""
    now = _controller(editor)
    editor.set("actuator", editor.found.layout.drive.name, controller=row([values.get(i, x) for i, x in enumerate(now)]))


def _controller(editor: MjcfEditor) -> list[float]:
    """Numbers of the controller (6) as the file now has them."""
    drive = editor.found.layout.drive
    given = editor.node("actuator", drive.name).attributes.get("controller", "").split()
    return [float(x) for x in given] if len(given) == len(CONTROLLER) else controller_of(editor.model, drive.id)


def _is_motor(editor: MjcfEditor) -> bool:
    """Whether the drive is a ``<dcmotor>`` as the file now stands."""
    drive = editor.found.layout.drive
    return drive.law.form is Form.DCMOTOR and editor.node("actuator", drive.name).tag == "dcmotor"


def _is_pid(editor: MjcfEditor, name: str) -> bool:
    return editor.node("actuator", name).attributes.get("gaintype") == "pid"
