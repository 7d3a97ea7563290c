"""The corrected MJCF of a servo robot, from the searches at its joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.robot.servos.bodies import GRAVITY, changes
from diagnose.robot.servos.pipeline import ServoOutcome
from diagnose.robot.servos.state import JointSearch
from mjsim.robot.carried import effect_of_slots
from mjsim.robot.drives import JointDrive
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot
from mjsim.robot.write import write_robot
from mjsim.robot.write_servo import NewServo, can_be_pid
from mjsim.servo import Servo, Target

__all__ = ["write_corrected_servos"]

AT_DRIVE = {"forcerange", "slewmax", "ki"}  # native values of laws that stand at the actuator, others at the joint


def write_corrected_servos(
    model: Path, robot: Robot, outcome: ServoOutcome, path: Path, slots: Mapping[str, np.ndarray] | None = None
) -> None:
    """Write the corrected MJCF: gains, armature, damping, dry friction and springs in their elements, the rest carried.

    slots: by joint its numbers (K,), those of the diagnosis by default; without them a joint with no mismatch stays as it is.
    """
    joints: dict[str, dict[str, float]] = {}
    servos, carried = [], []
    for s in outcome.searches:
        if outcome.diagnosis.joints[s.problem.name].verdict.value == "no_mismatch" and s.problem.name not in (slots or {}):
            continue
        p = (slots or {}).get(s.problem.name, s.now.fit.slots)
        joints[s.problem.name], own = _joint_values(robot, s, p)
        d = s.problem.drive
        carried += [*own, *_line(s, p, own)]
        at_drive = {key for x in s.now.laws for key in x.native} & AT_DRIVE
        slew = float(p[SLOT["slew"]]) * abs(d.gear) if "slewmax" in at_drive and _pid(robot, d) else None
        integral = float(p[SLOT["integral"]]) / d.gear**2
        given = float(s.problem.nominal[SLOT["integral"]]) > 0.0
        ki = integral if given or ("ki" in at_drive and _pid(robot, d)) else None
        servos.append(NewServo(d.actuator, d.servo, new_servo(d, p, "forcerange" in at_drive), slew, ki))
    m = outcome.masses
    links = robot.nominal - robot.fixed + np.einsum("clk,c->lk", changes(robot, m.numbers), m.x)
    lifted = next(((n.nominal + float(m.x[k])) for k, n in enumerate(m.numbers) if n.kind == GRAVITY and m.x[k] != 0.0), None)
    soft = {s.problem.name for s in outcome.searches if s.problem.is_soft}
    write_robot(model, robot, path, links, joints, carried, servos, lifted, soft)


def _line(s: JointSearch, p: np.ndarray, carried: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The torque-speed limit of the file's <dcmotor>, which the <general> in its place does not have."""
    slots = {name: float(p[SLOT[name]]) for name in ("stall", "no_load")}
    if not slots["stall"] > 0.0:
        return []
    line = effect_of_slots(s.problem.name, "actuator", slots)
    return [] if any(e["effect"] == line["effect"] for e in carried) else [line]


def _pid(robot: Robot, d: JointDrive) -> bool:
    return can_be_pid(robot.model, d.actuator, d.servo)


def new_servo(drive: JointDrive, p: np.ndarray, limited: bool) -> Servo:
    """The servo of slots (K,), at the actuator."""
    g = drive.gear
    kp, kv = float(p[SLOT["kp"]]) / g**2, float(p[SLOT["kv"]]) / g**2
    limit = float(p[SLOT["limit"]]) / abs(g) if limited else drive.servo.limit
    if drive.servo.target is Target.VELOCITY:
        return dataclasses.replace(drive.servo, kv=kv, limit=limit)
    return dataclasses.replace(drive.servo, kp=kp, kv=kv, zero=float(p[SLOT["zero"]]) * g - drive.length, limit=limit)


def _joint_values(robot: Robot, s: JointSearch, p: np.ndarray) -> tuple[dict[str, float], list[Mapping[str, Any]]]:
    """Attributes of the joint with slots (K,), and the effects that MJCF has no element for."""
    at = robot.leading(s.problem.joint)
    values = {}
    for name, own in (("armature", robot.armature[at]), ("damping", robot.damping[at])):  # tied joints keep what they have
        values[name] = max(float(p[SLOT[name]] - s.problem.nominal[SLOT[name]] + own), 0.0)
    carried: list[Mapping[str, Any]] = []
    own_friction = s.problem.nominal[SLOT["friction"]] > 0
    named = dict(zip(SLOT, map(float, p), strict=True))
    for law in s.now.laws:
        sprung = "stiffness" in law.native and float(robot.stiffness[at]) != 0.0  # the file's own spring stays
        if law.native and not sprung and (_pid(robot, s.problem.drive) or not law.native.keys() & {"slewmax", "ki"}):
            values |= {key: float(p[SLOT[slot]]) for key, slot in law.native.items() if key not in AT_DRIVE}
            if "stiffness" in law.native:
                values["springref"] = 0.0
            continue
        if law.dry:
            own_friction = False
            values["frictionloss"] = 0.0
        parameters = {k: v[0] for k, v in law.values(named).items()} | {k: named[slot] for k, slot in law.kept}
        carried.append(
            {"effect": law.id, "form": law.form, "joint": s.problem.name, "place": law.place, "parameters": parameters}
            | ({"from": law.source} if law.source else {})
        )
    if own_friction:
        values["frictionloss"] = float(p[SLOT["friction"]])
    return values, carried
