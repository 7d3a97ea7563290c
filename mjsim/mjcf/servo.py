"""Servos of MJCF, read: ``position``, ``velocity``, ``intvelocity``, ``pid``, ``dcmotor`` and ``general`` with an affine bias.

An actuator gives force = gain u + b0 + b1 l + b2 l', with l the length of its transmission (`mjsim.mjcf.drive_laws`). That is a
servo (`mjsim.servo.Servo`) where b1 or b2 is below zero: kp = -b1, kv = -b2, scale = gain / kp, zero = -b0 / kp (by kv for a
velocity).
"""

from __future__ import annotations

import math

import mujoco

from mjsim.errors import InputError
from mjsim.mjcf.drive_laws import Form, law_of, range_of
from mjsim.servo import Servo, Target

__all__ = ["bias_of", "read_servo"]

PREFERRED = "<position>, <velocity>, <intvelocity>, <pid>, <dcmotor>, <general> with an affine bias, or <motor>"


def read_servo(model: mujoco.MjModel, a: int, source: object, name: str) -> Servo | None:
    """The servo of an actuator, None when its input is a torque. Raises InputError for laws that are none of these."""
    law, bias = law_of(model, a), mujoco.mjtBias(int(model.actuator_biastype[a]))
    where = f"{source}: actuator {name!r}"
    if law.form is Form.GENERAL and bias not in (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE):
        raise InputError(where, "its force depends on the motion by a law of its own", PREFERRED, "use one of these")
    if not law.servo:
        return None
    gain, constant, of_length, of_speed = law.gain, law.constant, law.of_length, law.of_speed
    if of_length > 0.0 or of_speed > 0.0 or gain <= 0.0:
        raise InputError(
            where, f"gainprm {gain:g}, biasprm {constant:g} {of_length:g} {of_speed:g} pushes away from the command",
            "gainprm above zero, biasprm at or below zero", "correct the signs",
        )  # fmt: skip
    integrated = mujoco.mjtDyn(int(model.actuator_dyntype[a])) == mujoco.mjtDyn.mjDYN_INTEGRATOR
    if of_length == 0.0 and integrated:
        raise InputError(where, "the integral of its command is a speed", PREFERRED, "use one of these")
    target = Target.VELOCITY if of_length == 0.0 else Target.INTEGRATED if integrated else Target.POSITION
    own = -of_speed if target is Target.VELOCITY else -of_length
    low, high = range_of(model, a)
    zero = 0.0 if law.integral else -constant / own + 0.0  # beside integral action a constant force is a part of its start
    return Servo(0.0 - of_length, 0.0 - of_speed, target, _limit(model, a, where), zero, gain / own, low, high)


def _limit(model: mujoco.MjModel, a: int, where: str) -> float:
    if not model.actuator_forcelimited[a]:
        return math.inf
    low, high = map(float, model.actuator_forcerange[a])
    if abs(low + high) > 1e-9 * abs(high - low):
        raise InputError(where, f"forcerange is {low:g} .. {high:g}", "a range symmetric about zero", "correct it")
    return high


def bias_of(servo: Servo, offset: float = 0.0) -> tuple[float, float, float]:
    """biasprm of a servo, with a constant force beside its own."""
    own = servo.kv if servo.target is Target.VELOCITY else servo.kp
    return offset - own * servo.zero, -servo.kp, -servo.kv
