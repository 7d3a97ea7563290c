"""Laws of actuators: the force over the command, and laws that no drive of a chain stands for, each with what works in its place.

    force = gain u + constant + of_length l + of_speed l'        u: the first control, l: length of the transmission

``<motor>``, ``<position>``, ``<velocity>``, ``<intvelocity>`` and ``<general>`` of fixed gain are this law as they stand.
``<pid>`` is it by the inputs that it has, further ones being held at zero; with a setpoint ``pos`` there may be a force
ki act beside it, act' = u - l:

    pos, pos vel    gain = kp, of_length = -kp, of_speed = -kv        the setpoint u slewed by slewmax
    vel             gain = kv, of_speed = -kv                         of kp = 0
    ff              gain = 1, of_speed = -kv                          of kp = 0

Source: MuJoCo documentation, XML reference, ``actuator/general``, ``actuator/pid``, ``actuator/dcmotor``; plugin ``mujoco.pid``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

__all__ = ["IMAX", "DriveLaw", "begin", "inputs_of", "law_of", "range_of", "refused_law"]

INPUTS = mujoco.mjtCtrlInput
POS, VEL, FF = int(INPUTS.mjINPUT_POS), int(INPUTS.mjINPUT_VEL), int(INPUTS.mjINPUT_FF)
WORDS = {POS: "pos", VEL: "vel", FF: "ff"}
IMAX, SLEW = 0, 1  # of dynprm of a pid
PIDS = (POS, POS | VEL, VEL, FF)  # inputs of a pid that are a servo or a torque


@dataclass(frozen=True)
class DriveLaw:
    """The law of an actuator, as in the module's text.

    inputs: names of the controls of a ``<pid>``, the command first, empty of an actuator with one; slew: largest speed of the
    setpoint [rad/s | m/s]; integral: its ki [N m/(rad s) | N/(m s)].
    """

    gain: float
    constant: float = 0.0
    of_length: float = 0.0
    of_speed: float = 0.0
    inputs: tuple[str, ...] = ()
    slew: float = math.inf
    integral: float = 0.0


def law_of(model: mujoco.MjModel, a: int) -> DriveLaw:
    """The law of actuator ``a``, which `refused_law` lets pass."""
    constant, of_length, of_speed = (float(x) for x in model.actuator_biasprm[a, :3])
    if _gain(model, a) == mujoco.mjtGain.mjGAIN_PID:
        spec = int(model.actuator_ctrlspec[a])
        gain = -of_length if spec & POS else -of_speed if spec & VEL else 1.0
        slew = float(model.actuator_dynprm[a, SLEW])
        ki = float(model.actuator_gainprm[a, 0]) if spec & POS else 0.0
        return DriveLaw(gain, constant, of_length, of_speed, inputs_of(model, a), slew if slew > 0 else math.inf, ki)
    gain = float(model.actuator_gainprm[a, 0])
    if int(model.actuator_biastype[a]) == mujoco.mjtBias.mjBIAS_NONE:
        return DriveLaw(gain)
    return DriveLaw(gain, constant, of_length, of_speed)


def inputs_of(model: mujoco.MjModel, a: int) -> tuple[str, ...]:
    """Names of the controls of a ``<pid>``, in the order of ctrl."""
    return tuple(word for bit, word in WORDS.items() if int(model.actuator_ctrlspec[a]) & bit)


def range_of(model: mujoco.MjModel, a: int) -> tuple[float, float]:
    """Range to which MuJoCo clips the command of actuator ``a``, infinite where there is none."""
    at = int(model.actuator_ctrladr[a])
    if not model.actuator_ctrllimited[at]:
        return -math.inf, math.inf
    low, high = map(float, model.actuator_ctrlrange[at])
    return low, high


def begin(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    a: int,
    before: float,
    first: float,
    total: float | None = None,
    integral: float | None = None,
) -> None:
    """Set what actuator ``a`` keeps of its command, which was ``before`` for long: delay, filter, integrator, slewed setpoint.

    A slewed setpoint begins at the ``first`` command, unless that acts late. ``total``: state of an integrator, ``before`` where
    None. ``integral``: constant force of the actuator and that of its integral action together [N m | N]; the latter is zero
    where None. Further inputs of the actuator are zero.
    """
    kind, at, kept = (
        mujoco.mjtDyn(int(model.actuator_dyntype[a])),
        int(model.actuator_actadr[a]),
        int(model.actuator_history[a, 0]),
    )
    low, high = range_of(model, a)
    if kind == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        data.act[at] = before if total is None else total
    elif kind in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT):
        data.act[at] = min(max(before, low), high)
    elif kind == mujoco.mjtDyn.mjDYN_PID and math.isfinite(law_of(model, a).slew):
        data.act[at] = min(max(before if kept else first, low), high)
    law = law_of(model, a)
    if law.integral and integral is not None:
        data.act[at + math.isfinite(law.slew)] = (integral - law.constant) / law.integral
    if kept:
        held = np.zeros((kept, int(model.actuator_ctrlnum[a])))
        held[:, 0] = before
        mujoco.mj_initCtrlHistory(model, data, a, None, held)


def refused_law(model: mujoco.MjModel, a: int) -> tuple[str, str] | None:
    """What is outside in the law of actuator ``a``, and what to do instead; None where it is a torque or a servo's law."""
    if int(model.actuator_plugin[a]) >= 0:
        return (
            "takes its force from a plugin, which states no law",
            "where it is a PID without an integral part, use <position kp=... kv=...>; or record its torque and use <motor>",
        )
    if _gain(model, a) == mujoco.mjtGain.mjGAIN_DCMOTOR:
        return _dcmotor(model, a)
    if _gain(model, a) == mujoco.mjtGain.mjGAIN_PID:
        return _pid(model, a)
    if _gain(model, a) != mujoco.mjtGain.mjGAIN_FIXED:
        return "has a gain that depends on the motion", "use <motor>, or gaintype fixed"
    return None


def _gain(model: mujoco.MjModel, a: int) -> mujoco.mjtGain:
    return mujoco.mjtGain(int(model.actuator_gaintype[a]))


def _pid(model: mujoco.MjModel, a: int) -> tuple[str, str] | None:
    """Of inputs and gains that make no servo and no torque."""
    spec = int(model.actuator_ctrlspec[a])
    kp, ki = -float(model.actuator_biasprm[a, 1]), float(model.actuator_gainprm[a, 0])
    if spec not in PIDS:
        named = " ".join(inputs_of(model, a))
        return (
            f"is a <pid> with the inputs {named}, of which a log holds one",
            'use input="pos" (or "pos vel", its velocity setpoint held at zero), "vel" or "ff"',
        )
    imax = float(model.actuator_dynprm[a, IMAX])
    if ki and imax:
        return f"is a <pid> that stops its integral at imax = {imax:g}", 'use imax="0", where the integral stays within it'
    if spec & POS and kp == 0.0:
        return "is a <pid> with a position setpoint and kp = 0, which does nothing", 'give it kp, or use input="vel"'
    if not spec & POS and kp != 0.0:
        return (
            f'is a <pid> of input="{WORDS[spec]}" whose kp = {kp:g} holds the joint at 0',
            'write kp="0" (its default is 1), and give the joint that stiffness where there is such a spring',
        )
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
