"""The ``<general>`` that a short form of an actuator stands for, by the values that MuJoCo compiles of it.

Source: MuJoCo documentation, XML reference, ``actuator/position`` and the other short forms.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

__all__ = ["SHORT", "spelled_out"]

SHORT = ("kp", "kv", "dampratio", "timeconst", "inheritrange", "area", "diameter", "bias")
"""Attributes of <position>, <velocity>, <intvelocity>, <damper> and <cylinder> that <general> does not have."""
DYNAMICS = {
    mujoco.mjtDyn.mjDYN_NONE: "none",
    mujoco.mjtDyn.mjDYN_INTEGRATOR: "integrator",
    mujoco.mjtDyn.mjDYN_FILTER: "filter",
    mujoco.mjtDyn.mjDYN_FILTEREXACT: "filterexact",
}


def spelled_out(model: mujoco.MjModel, a: int, given: Mapping[str, str]) -> dict[str, str | None]:
    """Attributes of the <general> of actuator ``a``, of fixed gain and affine bias; None for those of ``given`` that go."""
    out: dict[str, str | None] = {key: None for key in SHORT if key in given}
    if "inheritrange" in given and model.actuator_ctrllimited[a]:
        out["ctrlrange"] = _row(model.actuator_ctrlrange[a])
    out |= {
        "dyntype": DYNAMICS[mujoco.mjtDyn(int(model.actuator_dyntype[a]))],
        "dynprm": _row(model.actuator_dynprm[a, :1]),
        "gaintype": "fixed",
        "gainprm": _row(model.actuator_gainprm[a, :1]),
        "biastype": "affine",
        "biasprm": _row(model.actuator_biasprm[a, :3]),
    }
    return out


def _row(values: object) -> str:
    return " ".join(repr(float(x)) for x in values)  # type: ignore[attr-defined]
