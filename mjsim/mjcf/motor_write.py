"""Writes cogging and bristles: at the ``<dcmotor>`` of the author's file that has them, else at a passive one that is added."""

from __future__ import annotations

import math

from mjsim.effects import native as N  # noqa: N812
from mjsim.mjcf.editor import MjcfEditor, element, row
from mjsim.mjcf.native_read import Motor, drive_motor, passive_motors
from mjsim.mjcf.slack_write import NOT_ONE_JOINT

__all__ = ["MotorWriter"]


class MotorWriter:
    """Writes cogging and bristles through an editor; ``step``: largest timestep [s] beside a bristle."""

    def __init__(self, editor: MjcfEditor, step: float) -> None:
        passive, drive = passive_motors(editor.found), drive_motor(editor.found)
        self.editor, self.step = editor, step
        self._motors = [*passive, *([] if drive is None else [drive])]
        editor.ignored += [m.name for m in passive]

    def bristle(self, value: N.Value, b: N.BodyBristle, new: tuple[str, str, str], scale: float = 1.0) -> None:
        """Write a bristle; ``new``: name, element and its name, of a motor that is added.

        ``scale``: travel of the element over that of the value's place. The Stribeck velocity does nothing at equal levels.
        """
        motor = self._holding(value)
        s = abs(motor.scale) if motor is not None else scale
        self.editor.step(self.step)
        levels = (b.level / s, (b.level + b.extra) / s)
        lugre = row((b.stiffness / s**2, b.damping / s**2, *levels, b.speed * s)) if b.level + b.extra > 0 else None
        self._write(motor, new, lugre=lugre)

    def cogging(self, value: N.Cogging) -> str:
        """Write cogging of the driven joint; what MuJoCo lacks of it."""
        joint = self.editor.joint_of(0)
        if joint is None:
            return NOT_ONE_JOINT
        motor = self._holding(value)
        s = motor.scale if motor is not None else 1.0
        cogging = row((value.amplitude / abs(s), value.cycles / abs(s), math.copysign(1.0, s) * value.phase))
        self._write(motor, (f"{joint}_cogging", "joint", joint), cogging=cogging)
        return ""

    def _holding(self, value: N.Value) -> Motor | None:
        """The motor of the author's file that stands for a value of this kind at this place."""

        def place(v: N.Value) -> tuple[type, object]:
            return type(v), getattr(v, "body", getattr(v, "coupling", None))

        return next((m for m in self._motors if place(value) in map(place, m.values)), None)

    def _write(self, motor: Motor | None, new: tuple[str, str, str], **attributes: str | None) -> None:
        """Change a motor of the file, or add a <dcmotor> without input and electric part."""
        if motor is not None:
            self.editor.set("actuator", motor.name, **attributes)
            return
        name = self.editor.fresh("actuator", new[0])
        given = {"name": name, new[1]: new[2], "input": "none", "resistance": "1", "motorconst": "0 0"}
        given |= {key: text for key, text in attributes.items() if text is not None}
        self.editor.add("actuator", "actuator", name, [element("dcmotor", close=True, **given)])
