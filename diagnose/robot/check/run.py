"""Check the log of a robot joint by joint against its model, before any physics is sought.

A servo's position is compared with its command, and its delay with that of the model's own closed-loop run. A torque is compared
with the torque that MuJoCo needs for the recorded motion, friction free beside it. Stamps are checked as those of one axis.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from diagnose.check.context import Context
from diagnose.check.faults.stamps import gaps, jitter
from diagnose.check.machine import Machine
from diagnose.check.thresholds import DISTINCT, FOLLOWED, PARAMETER_FACTOR
from diagnose.check.types import LogCheck, Problem, Severity
from diagnose.robot.check.absent import not_logged
from diagnose.robot.check.channels import MARKS, beyond_limits, clipped, clipped_torque, coarse, held_rows, refreshed
from diagnose.robot.check.faults import (
    ANGLES,
    LENGTHS,
    RATES,
    TORQUES,
    geared,
    late_or_early,
    out_of_range,
    scaled,
    slow,
    still,
    swapped,
)
from diagnose.robot.check.relations import Relation, correlations, relate
from diagnose.robot.contact import contact_notes, stretches
from diagnose.robot.servos.positions import moves, smoothed
from mjsim.quantity import Motion
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.drives import joint_drives
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot
from mjsim.robot.recording import ALIKE, UNLIKE, RobotRecording
from mjsim.robot.rows import mujoco_torque
from mjsim.robot.touching import touching
from mjsim.threads import one_thread

__all__ = ["check_robot"]


@dataclass(frozen=True, eq=False)
class Log:
    """One recording with its motion (N, m) behind a low-pass, and the inertia (m,) at each joint where it starts."""

    robot: Robot
    r: RobotRecording
    z: np.ndarray
    dz: np.ndarray
    ddz: np.ndarray

    def angle(self, joint: str) -> np.ndarray:
        """Recorded position (N,)."""
        return np.asarray(self.r.angle[:, self.r.joints.index(joint)])

    def channel(self, name: str, joint: str) -> np.ndarray | None:
        """A channel of a joint (N,), or None."""
        return np.asarray(getattr(self.r, name)[:, self.r.joints.index(joint)]) if self.r.has(name, joint) else None

    def slide(self, joint: str) -> bool:
        """Whether a joint is a slide."""
        return self.robot.motions[self.robot.joints.index(joint)] is Motion.SLIDE


@one_thread
def check_robot(robot: Robot, recordings: Sequence[RobotRecording]) -> LogCheck:
    """Check recordings of a robot against its nominal model; problems that must be fixed come first."""
    began = time.monotonic()
    problems: list[Problem] = []
    understood = {"robot": f"{len(robot.joints)} joints on a fixed base: {', '.join(robot.joints)}."}
    measured: dict[str, dict[str, Any]] = {}
    for r in recordings:
        found, told, numbers = _one(robot, r)
        problems += [dataclasses.replace(p, recording=r.source) for p in found]
        understood |= {f"{r.source}, {topic}" if len(recordings) > 1 else topic: text for topic, text in told.items()}
        measured[r.source] = numbers
    problems.sort(key=lambda p: p.severity is not Severity.FIX)
    return LogCheck(understood, tuple(problems), (), measured, {}, time.monotonic() - began, _asked(recordings))


def _asked(recordings: Sequence[RobotRecording]) -> tuple[str, ...]:
    """The questions that these recordings allow, in words."""
    several = any(len(r.joints) > 1 for r in recordings)
    by_command, by_torque = (any(getattr(r, c) is not None for r in recordings) for c in ("command", "torque"))
    return (
        "Are the stamps uniform, without gaps, and in seconds?", "Does every row hold a measurement of its own?",
        "Does each joint move, within its range?", "Is it free of contact?",
        "Are the channels off their limits, and finer than their steps?",
        *(("Do the channels of each joint belong to it?",) if several else ()),
        *(("Does each position follow its command: sign, unit, delay?",) if by_command else ()),
        *(("Does each torque move its joint as the model does: sign, unit?",) if by_torque else ()),
    )  # fmt: skip


def _one(robot: Robot, r: RobotRecording) -> tuple[list[Problem], dict[str, str], dict[str, Any]]:
    log = Log(robot, r, *smoothed(robot, r))
    problems = [*_stamps(r), *_swaps(log), *_held(log), *_contact(log), *not_logged(log.robot, r, log.z, log.dz, log.ddz)]
    crossed = {p.channel.rpartition(".")[0] for p in problems if p.problem == "swapped"}
    crossed |= {p.advice.rpartition(" ")[2] for p in problems if p.problem == "swapped"}
    size = f"{len(r)} samples, {1 / r.dt:.6g} samples/s, {len(r) * r.dt:.4g} s, input {r.hold} between samples."
    told = {"log": " ".join((size, *r.notes))}
    if r.held_at:
        told["not in the log"] = ", ".join(f"{name} (taken to be held at {at:.4g})" for name, at in r.held_at)
    numbers: dict[str, Any] = {"sample_time_s": r.dt}
    sound = not crossed
    for name in r.joints:
        found, text, relations = _joint(log, name, name in crossed)
        problems += found
        told[name] = text
        numbers[name] = {"unit": "m" if log.slide(name) else "rad", **{k: dataclasses.asdict(v) for k, v in relations.items()}}
        sound &= not any(p.severity is Severity.FIX for p in found)
    if sound:  # a run on commands of another unit or joint tells nothing
        problems += _in_milliseconds(log, _delays(log, numbers))
    return problems, told, numbers


def _stamps(r: RobotRecording) -> list[Problem]:
    """Jitter and gaps, by the checks of one axis: they use nothing but the stamps."""
    from mjsim.recording import Recording

    single = Recording(r.time, np.full(len(r), np.nan), None, r.angle[:, 0], r.dt, source=r.source)
    context = Context(single, None)  # type: ignore[arg-type]
    machine: Machine = context.machine
    return [*jitter(single, machine, context), *gaps(single, machine, context)]


def _contact(log: Log) -> list[Problem]:
    """Samples with a contact force, which no diagnosis compares."""
    found = touching(log.robot, log.z, log.dz, log.ddz, log.r.dt)
    told = contact_notes(log.robot, [(log.r.source, dataclasses.replace(found, always=()), log.r.dt)])
    at = np.asarray(found.rows.any(axis=1))
    return [
        Problem("time", "contact", float(at.mean()), "1", text, "record free motion, or exclude bodies that do not touch",
                Severity.LIMITS, marks=tuple((a, b) for a, b in stretches(at, log.r.dt)[:MARKS]))
        for text in told
    ]  # fmt: skip


def _swaps(log: Log) -> list[Problem]:
    """Commands that go with the position of another joint, and torques that go with the motion of another one."""
    r, robot, out = log.r, log.robot, []
    if r.command is not None:
        out += _crossed("command", r.joints, correlations(r.command, r.angle), "position")
    if r.torque is not None:
        needed = mujoco_torque(robot, log.z, log.dz, log.ddz)[:, [robot.joints.index(n) for n in r.joints]]
        out += _crossed("torque", r.joints, correlations(r.torque, needed), "motion")
    return out


def _crossed(channel: str, joints: Sequence[str], C: np.ndarray, what: str) -> list[Problem]:
    out = []
    for j, k in zip(*np.nonzero(np.triu(np.ones_like(C), 1)), strict=True):
        crossed, own = float(min(abs(C[j, k]), abs(C[k, j]))), float(max(abs(C[j, j]), abs(C[k, k])))
        if crossed > ALIKE and own < UNLIKE:
            out.append(swapped(channel, joints[j], joints[k], crossed, own, what))
    return out


def _joint(log: Log, name: str, crossed: bool) -> tuple[list[Problem], str, dict[str, Relation]]:
    """Problems of one joint, what was understood of it, and its relations by name."""
    robot, r, q = log.robot, log.r, log.angle(name)
    j = robot.joints.index(name)
    slide = log.slide(name)
    channels = [c for c in ("command", "torque", "velocity", "angle", "current", "second_angle") if r.has(c, name)]
    drive = joint_drives(robot)[j]
    kind = "servo" if drive is not None else "torque" if robot.driven[j] else "not driven"
    text = f"{'slide' if slide else 'hinge'}, {kind}; channels {', '.join(channels)}"
    text += f"; moves from {np.min(q):.4g} to {np.max(q):.4g} {'m' if slide else 'rad'}"
    if not moves(q):
        return [still(name, "angle")], f"{text}.", {}
    low, high = robot.ranges[robot.leading(j)]
    problems = out_of_range(name, float(low), float(high), float(np.min(q)), float(np.max(q)), slide)
    problems += [] if problems else beyond_limits(name, float(low), float(high), q, "m" if slide else "rad", r.time)
    problems += _by_themselves(log, name)
    relations: dict[str, Relation] = {}
    angles, lengths = (LENGTHS, LENGTHS) if slide else (ANGLES, RATES)
    for channel, reference, units, against in (
        ("velocity", log.dz[:, j], lengths, f"the rate of the angle of {name}"),
        ("second_angle", q, angles, f"the angle of {name}"),
    ):
        values = log.channel(channel, name)
        found = None if values is None else relate(reference, values, r.dt)
        if found is not None:
            relations[channel] = found
            faults = scaled(channel, name, found, units, against)
            if found.explained >= FOLLOWED and not faults:
                faults = late_or_early(channel, name, found.delay, (0.0, 0.0), r.dt, against)
            problems += faults
    if not crossed:
        outside = bool(problems) and problems[0].problem == "unit"
        found_ = _input(log, name, relations, angles, drive is not None and drive.velocity)
        problems += [p for p in found_ if not (outside and p.problem == "unit")]
    if relations:
        text += "; " + ", ".join(f"{k}: slope {v.slope:.3g}, delay {1e3 * v.delay:.3g} ms" for k, v in relations.items())
    return problems, f"{text}.", relations


def _by_themselves(log: Log, name: str) -> list[Problem]:
    """Responses that are clipped or coarse."""
    r, v, out = log.r, log.dz[:, log.robot.joints.index(name)], []
    length = "m" if log.slide(name) else "rad"
    for channel, unit in (("angle", length), ("second_angle", length), ("velocity", f"{length}/s"), ("current", "A")):
        x = log.channel(channel, name)
        if x is not None:
            fresh, held = refreshed(channel, name, x, r.dt)
            out += held or clipped(channel, name, fresh, unit, r.time)
            out += coarse(channel, name, x, v, unit) if channel != "current" else []
    return out


def _held(log: Log) -> list[Problem]:
    """Rows that repeat the row before in all responses."""
    r = log.r
    there = [x for c in ("angle", "second_angle", "velocity", "torque", "current") if (x := getattr(r, c)) is not None]
    return held_rows(np.nan_to_num(np.hstack(there)), r.angle, r.time)


def _input(log: Log, name: str, relations: dict[str, Relation], units: dict[float, str], velocity: bool) -> list[Problem]:
    """The command against the position, the torque against what the motion needs; the relations are added to ``relations``."""
    r, robot, j, out = log.r, log.robot, log.robot.joints.index(name), []
    command = log.channel("command", name)
    if command is not None:
        if np.ptp(command) == 0 and not np.any(command - (0.0 if velocity else log.angle(name)[0])):
            return [still(name, "command")]
        moved = log.dz[:, j] if velocity else log.angle(name)
        found = relate(_target(log, name, command), moved, r.dt)
        if found is not None:
            relations["velocity over command" if velocity else "angle over command"] = found
            faults = scaled("angle", name, found, RATES if velocity else units, f"the command of {name}")
            out += faults if faults and not _as_the_model(log, name, found, velocity) else []
    torque = log.channel("torque", name)
    if torque is not None:
        if np.ptp(torque) == 0:
            return [*out, still(name, "torque")]
        needed = mujoco_torque(robot, log.z, log.dz, log.ddz)[:, j] / robot.gear[j]
        friction = np.column_stack([log.dz[:, j], np.sign(log.dz[:, j])])
        found = relate(needed, torque, r.dt, friction, delays=False)
        if found is not None:
            relations["torque over the model's"] = found
            needs = f"the torque that the motion of {name} needs by the model"
            out += geared(name, found, float(log.robot.gear[j])) or scaled("torque", name, found, TORQUES, needs, DISTINCT)
            out += clipped_torque(name, torque, needed, log.dz[:, j], "N" if log.slide(name) else "N m", r.time)
    return out


def _as_the_model(log: Log, name: str, found: Relation, velocity: bool) -> bool:
    """Whether the model itself follows the command by a like slope: a weight and friction keep a weak servo from its target.

    Of a motor by its voltage no slope is a fault: what a volt does is a number of the motor.
    """
    robot, r = log.robot, log.r
    j = robot.joints.index(name)
    drive, command = joint_drives(robot)[j], log.channel("command", name)
    if drive is None or command is None:
        return False
    z = closed_loop(robot, r).z[:, j]
    own = relate(_target(log, name, command), np.gradient(z, r.dt) if velocity else z, r.dt) if np.isfinite(z).all() else None
    if own is None or own.slope * found.slope <= 0.0:
        return False
    return drive.servo.back_emf or abs(math.log(found.slope / own.slope)) < math.log(PARAMETER_FACTOR)


def _target(log: Log, name: str, command: np.ndarray) -> np.ndarray:
    """The position or velocity (N,) at the joint that the servo makes of its command: gear, scale and range of the actuator."""
    drive = joint_drives(log.robot)[log.robot.joints.index(name)]
    return command if drive is None else drive.target(command, log.r.dt, float(log.angle(name)[0]))


def _delays(log: Log, numbers: dict[str, Any]) -> list[Problem]:
    """Delays of positions behind commands, against those of the model's own run, and the servo's frequency against the rate."""
    robot, r, out = log.robot, log.r, []
    servos = [n for n in r.joints if joint_drives(robot)[robot.joints.index(n)] is not None and r.has("command", n)]
    servos = [n for n in servos if "angle over command" in numbers[n]]
    if not servos:
        return []
    inertia, drives = _inertia(robot, log.z[0]), joint_drives(robot)
    for name in servos:
        j = robot.joints.index(name)
        drive = drives[j]
        if drive is not None and not drive.velocity:
            out += slow(name, math.sqrt(float(drive.slots[SLOT["kp"]]) / inertia[j]) / (2 * math.pi), 1 / r.dt)
    if len(out) == len(servos):  # delays are below a sample, and a run takes as many steps as the stamps say
        return out
    run = closed_loop(robot, r)
    for name in servos:
        j = robot.joints.index(name)
        drive = drives[j]
        assert drive is not None
        command, model = log.channel("command", name), run.z[:, j]
        found = numbers[name]["angle over command"]
        if command is None or drive.velocity or not np.isfinite(model).all() or found["explained"] < FOLLOWED:
            continue
        own = relate(_target(log, name, command), model, r.dt)
        if own is None or own.explained < FOLLOWED:
            continue
        numbers[name]["model's delay_s"] = own.delay
        least, most = sorted((own.delay / PARAMETER_FACTOR, own.delay * PARAMETER_FACTOR))
        out += late_or_early("angle", name, found["delay"], (least, most), r.dt, f"the command of {name}")
    return out


def _in_milliseconds(log: Log, problems: list[Problem]) -> list[Problem]:
    """The problems, or one of the unit of time: no servo is in reach of the rate, in milliseconds all agree."""
    slow_ = {p.channel for p in problems if p.problem == "sample_rate"}
    if len(slow_) < len(log.r.joints):
        return problems
    r = dataclasses.replace(log.r, time=log.r.time / 1e3, dt=log.r.dt / 1e3)
    faster = Log(log.robot, r, *smoothed(log.robot, r))
    commands = {n: c for n in r.joints if (c := log.channel("command", n)) is not None}
    relations = {n: relate(_target(log, n, c), log.angle(n), r.dt) for n, c in commands.items()}
    numbers: dict[str, Any] = {
        n: {} if x is None else {"angle over command": dataclasses.asdict(x)} for n, x in relations.items()
    }
    if len(numbers) < len(r.joints) or _delays(faster, numbers) or not all("model's delay_s" in x for x in numbers.values()):
        return problems
    return [
        Problem(
            "time", "unit", 1e3, "1", f"The time is in milliseconds: at {log.r.dt:.4g} s a sample no servo is in reach, "
            f"at {log.r.dt:.4g} ms the positions follow their commands as the model does.",
            "give the unit of the time in the binding, or convert the column", Severity.FIX,
        )
    ]  # fmt: skip


def _inertia(robot: Robot, z: np.ndarray) -> np.ndarray:
    """Inertia (m,) at each independent joint in a pose (m,)."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.tie @ z + robot.rest
    mujoco.mj_forward(robot.model, data)
    M = np.zeros((robot.model.nv, robot.model.nv))
    mujoco.mj_fullM(robot.model, data, M)
    return np.asarray(np.einsum("im,ij,jm->m", robot.tie, M, robot.tie))
