"""The ``<general>`` that a short form of an actuator stands for, by the values that MuJoCo compiles of it.

Source: MuJoCo documentation, XML reference, ``actuator/position`` and the other short forms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco

from mjsim.mjcf.drive_laws import inputs_of, law_of, range_of

__all__ = ["SHORT", "spelled_out"]

SHORT = ("kp", "kv", "dampratio", "timeconst", "inheritrange", "area", "diameter", "bias", "ki", "imax", "slewmax", "posrange")
"""Attributes of <position>, <velocity>, <intvelocity>, <damper>, <cylinder> and <pid> that <general> does not have."""
DYNAMICS = {
    mujoco.mjtDyn.mjDYN_NONE: "none",
    mujoco.mjtDyn.mjDYN_INTEGRATOR: "integrator",
    mujoco.mjtDyn.mjDYN_FILTER: "filter",
    mujoco.mjtDyn.mjDYN_FILTEREXACT: "filterexact",
    mujoco.mjtDyn.mjDYN_PID: "pid",
}


def spelled_out(model: mujoco.MjModel, a: int, given: Mapping[str, str]) -> dict[str, str | None]:
    """Attributes of the <general> of actuator ``a``, of affine bias and of fixed or <pid>'s gain; None for those that go."""
    out: dict[str, str | None] = {key: None for key in SHORT if key in given}
    span = range_of(model, a)
    if ("inheritrange" in given or "posrange" in given) and math.isfinite(span[0]):
        out["ctrlrange"] = _row(span)
    inputs = inputs_of(model, a)
    pid = int(model.actuator_gaintype[a]) == mujoco.mjtGain.mjGAIN_PID and inputs != ("ff",)
    if pid:
        out["input"] = " ".join(inputs)
    elif inputs == ("ff",):  # a torque, as of <motor>
        out |= {"input": None, "ffrange": None, "ctrlrange": _row(span) if math.isfinite(span[0]) else None}
    out |= {
        "dyntype": DYNAMICS[mujoco.mjtDyn(int(model.actuator_dyntype[a]))],
        "dynprm": _row(model.actuator_dynprm[a, : 2 if pid else 1]),
        "gaintype": "pid" if pid else "fixed",
        "gainprm": _row(model.actuator_gainprm[a, :1] if pid else (law_of(model, a).gain,)),
        "biastype": "affine",
        "biasprm": _row(model.actuator_biasprm[a, :3]),
    }
    return out


def _row(values: object) -> str:
    return " ".join(repr(float(x)) for x in values)  # type: ignore[attr-defined]
