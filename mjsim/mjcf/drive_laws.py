"""Laws of actuators that no drive of a chain stands for, each with what works in its place.

A ``<dcmotor>`` without inductance gives (K / R) (u - K w): the torque of a ``<motor>`` of gear K / R beside a damping K^2 / R.
Source: MuJoCo documentation, XML reference, ``actuator/dcmotor``; plugin ``mujoco.pid``.
"""

from __future__ import annotations

import mujoco

__all__ = ["refused_law"]


def refused_law(model: mujoco.MjModel, a: int) -> tuple[str, str] | None:
    """What is outside in the law of actuator ``a``, and what to do instead; None where it is a torque or a servo's law."""
    if int(model.actuator_plugin[a]) >= 0:
        return (
            "takes its force from a plugin, which states no law",
            "where it is a PID without an integral part, use <position kp=... kv=...>; or record its torque and use <motor>",
        )
    if mujoco.mjtGain(int(model.actuator_gaintype[a])) == mujoco.mjtGain.mjGAIN_DCMOTOR:
        return _dcmotor(model, a)
    if mujoco.mjtGain(int(model.actuator_gaintype[a])) != mujoco.mjtGain.mjGAIN_FIXED:
        return "has a gain that depends on the motion", "use <motor>, or gaintype fixed"
    return None


def _dcmotor(model: mujoco.MjModel, a: int) -> tuple[str, str]:
    """Of a motor with a voltage as its input."""
    resistance, constant = map(float, model.actuator_gainprm[a, :2])
    gear = float(model.actuator_gear[a, 0])
    if not resistance > 0:
        return "is a <dcmotor> whose torque depends on the motion", "use <motor>, and record the torque"
    force, damping = constant / resistance, constant**2 / resistance
    return (
        "is a <dcmotor> whose torque depends on the motion",
        f"use <motor> with {force * gear:.6g} as its gear (voltage as its input), and add {damping * gear**2:.6g} to the damping "
        "of the joint: the same motor without inductance, thermal model or controller",
    )
