"""The ``<general>`` that a short form of an actuator stands for, by the values that MuJoCo compiles of it.

Source: MuJoCo documentation, XML reference, ``actuator/position`` and the other short forms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco

from mjsim.mjcf.drive_laws import IMAX, Form, law_of, range_of

__all__ = ["SHORT", "spelled_out"]

SHORT = (
    "kp", "kv", "dampratio", "timeconst", "inheritrange", "area", "diameter", "bias", "ki", "imax", "slewmax", "posrange",
    "resistance", "motorconst", "nominal", "inductance", "thermal", "saturation", "cogging", "lugre", "controller",
)  # fmt: skip
"""Attributes of the short forms of an actuator that <general> does not have."""
DYNAMICS = {
    mujoco.mjtDyn.mjDYN_NONE: "none",
    mujoco.mjtDyn.mjDYN_INTEGRATOR: "integrator",
    mujoco.mjtDyn.mjDYN_FILTER: "filter",
    mujoco.mjtDyn.mjDYN_FILTEREXACT: "filterexact",
}


def spelled_out(model: mujoco.MjModel, a: int, given: Mapping[str, str]) -> dict[str, str | None]:
    """Attributes of the <general> of actuator ``a``, of affine bias and of fixed or <pid>'s gain; None for those that go."""
    out: dict[str, str | None] = {key: None for key in SHORT if key in given}
    span = range_of(model, a)
    if ("inheritrange" in given or "posrange" in given) and math.isfinite(span[0]):
        out["ctrlrange"] = _row(span)
    law = law_of(model, a)
    states = math.isfinite(law.slew) or law.integral != 0.0
    if states or len(law.inputs) > 1 or (law.form is Form.PID and law.inputs != ("ff",)):
        imax = float(model.actuator_dynprm[a, IMAX]) if law.form is Form.PID else 0.0
        numbers = _row((imax, law.slew if math.isfinite(law.slew) else 0.0))
        out |= {"input": " ".join(law.inputs), "dyntype": "pid" if states else "none", "dynprm": numbers}
        out |= {"gaintype": "pid", "gainprm": _row((law.integral,))}
    else:
        kind = mujoco.mjtDyn(int(model.actuator_dyntype[a]))
        dynamics, numbers = DYNAMICS.get(kind, "none"), _row(model.actuator_dynprm[a, :1])
        out |= {"dyntype": dynamics, "dynprm": numbers, "gaintype": "fixed", "gainprm": _row((law.gain,))}
    if out["gaintype"] == "fixed" and law.form is not Form.GENERAL:  # of one input, whose range is that of any actuator
        out |= {key: None for key in ("input", "velrange", "ffrange") if key in given}
        out["ctrlrange"] = _row(span) if math.isfinite(span[0]) else None
    if "saturation" in given and model.actuator_forcelimited[a]:
        out |= {"forcelimited": "true", "forcerange": _row(model.actuator_forcerange[a])}
    return out | {"biastype": "affine", "biasprm": _row((law.constant, law.of_length, law.of_speed))}


def _row(values: object) -> str:
    return " ".join(repr(float(x)) for x in values)  # type: ignore[attr-defined]
