"""Writes a servo into a copy of an MJCF, as the ``<general>`` that every servo stands for."""

from __future__ import annotations

from mjsim.mjcf.editor import MjcfEditor, number
from mjsim.mjcf.servo import bias_of
from mjsim.servo import Servo, Target

__all__ = ["write_servo"]

SHORT = ("kp", "kv", "dampratio", "timeconst", "inheritrange")  # attributes of <position>, which <general> does not have


def write_servo(editor: MjcfEditor, new: Servo | None) -> None:
    """Write gains, zero and force limit of a servo where they differ from the file's, as a ``<general>``."""
    old = editor.chain.servo
    if new is None or old == new:
        return
    name, node = editor.found.layout.drive.name, editor.node("actuator", editor.found.layout.drive.name)
    dyntype = node.attributes.get("dyntype")
    time = editor.model.actuator_dynprm[editor.found.layout.drive.id, 0]
    filtered = "timeconst" in node.attributes and dyntype is None
    integrated = node.tag == "intvelocity"
    for key in SHORT:
        if key in node.attributes:
            editor.set("actuator", name, **{key: None})
    editor.general()
    if filtered:
        editor.set("actuator", name, dyntype="filterexact", dynprm=number(float(time)))
    if integrated:
        editor.set("actuator", name, dyntype="integrator")
    own = new.kv if new.target is Target.VELOCITY else new.kp
    bias = " ".join(number(x) for x in bias_of(new))
    editor.set("actuator", name, gaintype="fixed", gainprm=number(own * new.scale), biastype="affine", biasprm=bias)
    if old is not None and new.limit != old.limit:
        editor.set("actuator", name, forcelimited="true", forcerange=f"{number(-new.limit)} {number(new.limit)}")
