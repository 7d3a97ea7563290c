"""Check the log of one axis under a servo: the check of a robot's joint, with the axis' own names of channels.

A servo's log has a command and a position and no torque, so that the checks of `diagnose.check`, which compare a torque with
the motion, do not apply; those of a robot's joint compare the position with the command.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from diagnose.check.faults.short import too_short
from diagnose.check.types import LogCheck, Problem
from diagnose.check.unused import unused_channels
from diagnose.data.experiment import measured_count
from diagnose.data.servo import command_of
from diagnose.robot.check.run import check_robot
from mjsim.axis import Chain
from mjsim.errors import InputError
from mjsim.quantity import Motion
from mjsim.recording import Recording
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.servo import Target

__all__ = ["check_servo_axis"]


def check_servo_axis(chain: Chain, robot: Robot, recordings: Sequence[Recording]) -> LogCheck:
    """Check recordings of an axis whose chain has a servo; ``robot``: the same file as a robot, for MuJoCo's run.

    Channels of the problems are those of the axis: angle, velocity, command, time. Where a velocity servo's log has no angle it
    is the integral of the velocity. Raises InputError for a log without a command, or of a position servo without an angle.
    """
    name = _driven(robot)
    found = check_robot(robot, [_as_robot(chain, robot, name, r) for r in recordings])
    told = {"chain": _chain(chain), "servo": _servo(chain)}
    for topic, text in found.understood.items():
        if topic != "robot":
            told["axis" if topic == name else topic] = text
    unused = unused_channels(recordings, servo=True)
    if unused:
        told["channels not fitted"] = " ".join(unused)
    measured = {source: {"axis" if key == name else key: v for key, v in numbers.items()}
                for source, numbers in found.measured.items()}  # fmt: skip
    together = sum(map(measured_count, recordings))
    short = tuple(dataclasses.replace(p, recording=r.source) for r in recordings for p in too_short(r, together))
    problems = (*short, *(_renamed(p, name) for p in found.problems))
    return dataclasses.replace(found, understood=told, problems=problems, measured=measured)


def _driven(robot: Robot) -> str:
    """The independent joint that the servo drives."""
    return robot.joints[int(np.flatnonzero(robot.driven)[0])]


def _as_robot(chain: Chain, robot: Robot, name: str, r: Recording) -> RobotRecording:
    command, angle = command_of(chain, r), r.angle
    if angle is None and (r.velocity is None or chain.servo is None or chain.servo.target is not Target.VELOCITY):
        raise InputError(
            r.source, "a command and no angle", "the angle of the joint, which the check compares with the command",
            "record or bind it",
        )  # fmt: skip
    if angle is None:
        assert r.velocity is not None
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (r.velocity[1:] + r.velocity[:-1])) * r.dt])
    torque = None if np.isnan(r.torque).any() else r.torque[:, None]
    held = tuple((j, float(robot.model.qpos0[robot.leading(k)])) for k, j in enumerate(robot.joints) if j != name)
    return RobotRecording(
        r.time, (name,), r.dt, angle[:, None], torque=torque, command=command[:, None],
        velocity=None if r.velocity is None else r.velocity[:, None], source=r.source, sha256=r.sha256, hold=r.hold, held_at=held,
        notes=r.notes,
    )  # fmt: skip


def _renamed(problem: Problem, name: str) -> Problem:
    """A problem in the names of the axis: ``angle`` for ``JOINT.angle``."""
    return dataclasses.replace(
        problem, channel=problem.channel.removeprefix(f"{name}."), advice=problem.advice.replace(f"{name}.", "")
    )


def _chain(chain: Chain) -> str:
    unit = "kg" if chain.motion is Motion.SLIDE else "kg m^2"
    bodies = ", ".join(f"{b.place} (joint {b.joint!r}, inertia {b.inertia:.4g} {unit})" for b in chain.bodies)
    return f"{len(chain.bodies)} {'inertia' if len(chain.bodies) == 1 else 'inertias'}: {bodies}."


def _servo(chain: Chain) -> str:
    servo = chain.servo
    assert servo is not None
    limit = f", force at most {servo.limit:.4g}" if np.isfinite(servo.limit) else ""
    kp = "" if servo.kp == 0 else f"kp {servo.kp:.4g}, "
    name = f"actuator {chain.actuator!r}" if chain.actuator else "the actuator"
    takes = f"the {servo.target.value} of the joint"
    if servo.back_emf:
        takes = "a voltage, or another control value of a motor with a back-EMF"
    gain = f"gain {servo.gain:.4g}, " if servo.back_emf else ""
    return f"{name} takes {takes}: {gain}{kp}kv {servo.kv:.4g}{limit}."
