"""The servos of a robot's joints as slots of `mjsim.robot.joint_kernel`, gears taken out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.mjcf.drive_laws import Form, has_more, law_of, refused_law
from mjsim.mjcf.servo import PREFERRED, read_servo
from mjsim.robot.joint_kernel import SLOT, empty
from mjsim.robot.model import Robot
from mjsim.servo import Servo, Target

__all__ = ["JointDrive", "has_servos", "joint_drives"]


@dataclass(frozen=True, eq=False)
class JointDrive:
    """The servo of one joint.

    actuator: its index; servo: its law as the file has it; gear: joint torque over actuator force; slots (K,): the joint as
    the file has
    it, at the joint; length: of the actuator where the joint is at 0, beyond which it acts; idle: its inputs beside the command.
    """

    joint: int
    actuator: int
    servo: Servo
    gear: float
    slots: np.ndarray
    length: float = 0.0
    idle: tuple[str, ...] = ()

    @property
    def velocity(self) -> bool:
        """Whether the command is a velocity, or the voltage of a motor with a back-EMF."""
        return self.servo.target is Target.VELOCITY

    def target(self, command: np.ndarray, dt: float, start: float) -> np.ndarray:
        """Command (N,) as a position [rad | m] or velocity of the joint; the integral of one that is integrated, from
        ``start``."""
        clipped = self.servo.scale * np.clip(command, self.servo.low, self.servo.high) / self.gear
        if self.servo.target is Target.INTEGRATED:
            return start + self.length / self.gear + np.concatenate([[0.0], np.cumsum(clipped[:-1]) * dt])
        return np.asarray(clipped)


def has_servos(robot: Robot) -> bool:
    """Whether any joint is driven by a servo."""
    return any(drive is not None for drive in _servos(robot))


def _servos(robot: Robot) -> list[tuple[int, Servo] | None]:
    found: list[tuple[int, Servo] | None] = [None] * len(robot.joints)
    model = robot.model
    for j, a in enumerate(robot.actuators):
        if a >= 0:
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, a) or f"actuator {a}"
            refused = refused_law(model, a)
            if refused is not None:
                raise InputError(f"{robot.source}: actuator {name!r}", refused[0], PREFERRED, refused[1])
            law = law_of(model, a)
            if law.integral and law.form is Form.DCMOTOR:
                raise InputError(
                    f"{robot.source}: actuator {name!r}", f"a <dcmotor> with integral action, ki = {law.integral:g}, in a robot",
                    "a <pid>", 'use <pid ki=...> where its limits are not reached, or leave ki out',
                )  # fmt: skip
            if law.form is Form.DCMOTOR and has_more(model, a):
                raise InputError(
                    f"{robot.source}: actuator {name!r}", "cogging or bristles of a <dcmotor> in a robot", "a motor without them",
                    "leave cogging and lugre out in a copy of the model: what acts of them is found as an effect",
                )  # fmt: skip
            servo = read_servo(model, a, robot.source, name)
            found[j] = None if servo is None else (a, servo)
    return found


def joint_drives(robot: Robot) -> tuple[JointDrive | None, ...]:
    """The servo of each independent joint, None where an actuator gives a torque or there is none. Raises InputError."""
    out: list[JointDrive | None] = []
    for j, found in enumerate(_servos(robot)):
        if found is None:
            out.append(None)
            continue
        a, servo = found
        g, length, p = float(robot.gear[j]), float(robot.length[j]), empty()
        p[SLOT["kp"]], p[SLOT["kv"]] = g * g * servo.kp, g * g * servo.kv
        p[SLOT["limit"]], p[SLOT["zero"]] = abs(g) * servo.limit, (servo.zero + length) / g
        square = robot.tie[:, j] ** 2
        p[SLOT["armature"]], p[SLOT["damping"]] = float(robot.armature @ square), float(robot.damping @ square)
        p[SLOT["friction"]] = float(robot.frictionloss @ np.abs(robot.tie[:, j]))
        p[SLOT["delay"]] = _delay(robot.model, a)
        if robot.model.actuator_dyntype[a] in (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT)):
            p[SLOT["lag"]] = float(robot.model.actuator_dynprm[a, 0])
        law = law_of(robot.model, a)
        if math.isfinite(law.slew):
            p[SLOT["slew"]] = law.slew / abs(g)
        if math.isfinite(law.stall):
            p[SLOT["stall"]], p[SLOT["no_load"]] = law.stall * abs(g), law.no_load / abs(g)
        p[SLOT["integral"]] = g * g * law.integral
        out.append(JointDrive(j, a, servo, g, p, length, law.inputs[1:]))
    return tuple(out)


def _delay(model: mujoco.MjModel, a: int) -> float:
    value = float(model.actuator_delay[a]) if hasattr(model, "actuator_delay") else 0.0
    return value if math.isfinite(value) else 0.0


def need_command(robot: Robot, source: str) -> InputError:
    """The error for a log of servos without a command."""
    name = robot.joints[0]
    return InputError(
        source, "no joint that a servo drives has a command and a position and moves", f"columns such as {name}.command_rad and "
        f"{name}.angle_rad", "add or bind them",
    )  # fmt: skip
