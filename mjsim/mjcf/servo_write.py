"""Writes a servo into a copy of an MJCF, as the ``<general>`` that every servo stands for."""

from __future__ import annotations

from mjsim.mjcf.editor import MjcfEditor, number
from mjsim.mjcf.servo import bias_of
from mjsim.servo import Servo, Target

__all__ = ["write_servo"]


def write_servo(editor: MjcfEditor, new: Servo | None) -> None:
    """Write gains, zero and force limit of a servo where they differ from the file's, as a ``<general>``."""
    old = editor.chain.servo
    if new is None or old == new:
        return
    name = editor.general()
    own = new.kv if new.target is Target.VELOCITY else new.kp
    bias = " ".join(number(x) for x in bias_of(new))
    editor.set("actuator", name, gaintype="fixed", gainprm=number(own * new.scale), biastype="affine", biasprm=bias)
    if old is not None and new.limit != old.limit:
        editor.set("actuator", name, forcelimited="true", forcerange=f"{number(-new.limit)} {number(new.limit)}")
