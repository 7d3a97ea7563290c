"""Check the log of one axis under a servo: the check of a robot's joint, with the axis' own names of channels.

A servo's log has a command and a position and no torque, so that the checks of `diagnose.check`, which compare a torque with
the motion, do not apply; those of a robot's joint compare the position with the command.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from diagnose.check.excitation import families, motion_from
from diagnose.check.faults.short import too_short
from diagnose.check.machine import Machine
from diagnose.check.relation import Signals
from diagnose.check.spectrum import noise_level
from diagnose.check.thresholds import MODE_RATE
from diagnose.check.types import Excitation, LogCheck, Problem, Severity
from diagnose.check.unused import unused_channels
from diagnose.data.experiment import measured_count
from diagnose.data.servo import command_of
from diagnose.robot.check.run import check_robot
from mjsim.axis import Axis, Chain
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
    can = tuple(_excitation(chain, recordings)) if not any(p.severity is Severity.FIX for p in problems) else ()
    return dataclasses.replace(found, understood=told, problems=problems, measured=measured, excitation=can)


def _excitation(chain: Chain, recordings: Sequence[Recording]) -> list[Excitation]:
    """What the motion can show, the servo's own frequency first; where nothing of the log has to be fixed."""
    machine, servo, motions = Machine.of(Axis(chain)), chain.servo, []
    assert servo is not None
    for r in recordings:
        response = r.angle if r.angle is not None else r.velocity
        assert response is not None
        velocity = r.velocity if r.angle is None else None
        error = _error(chain, r)
        if np.ptp(response) > 0.0 and np.ptp(error) > 0.0:
            motions.append(motion_from(Signals(r.dt, error, velocity, r.angle), noise_level(response)))
    if not motions:
        return []
    rate, band = min(1.0 / r.dt for r in recordings), max(m.bandwidth for m in motions)
    stiffness = chain.gain**2 * servo.kp / machine.inertia
    own = (math.sqrt(stiffness) if stiffness > 0.0 else chain.gain**2 * servo.kv / machine.inertia) / (2 * math.pi)
    reached = own < min(rate / MODE_RATE, band)
    word = "reached" if reached else "not reached, so that its gains show as a lag"
    above = f"the motion stands above its noise up to {band:.3g} Hz, at {rate:.4g} samples/s"
    gains = Excitation(f"servo at {own:.3g} Hz", reached, f"{word}: {above}")
    return [gains, *families(motions, rate, machine)]


def _error(chain: Chain, r: Recording) -> np.ndarray:
    """Target of the servo less its position, or velocity (N,), which goes with the torque of the drive."""
    servo = chain.servo
    assert servo is not None
    target = servo.scale * np.clip(command_of(chain, r), servo.low, servo.high)
    if servo.target is Target.INTEGRATED:
        target = np.cumsum(target) * r.dt
    if servo.target is Target.VELOCITY:
        moved = r.velocity if r.velocity is not None else np.gradient(np.asarray(r.angle), r.dt)
    else:
        moved = np.asarray(r.angle)
    return np.asarray(target - chain.gain * moved)


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
