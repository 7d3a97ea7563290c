"""The diagnosis of a servo robot as files: corrected.xml from the searches at its joints, and both files in MuJoCo beside the
log."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.result import FitFigures, Verdict
from diagnose.robot.motion import LEAST_MOVED
from diagnose.robot.pipeline import ORDER, summary
from diagnose.robot.result import JointResult, RobotDiagnosis
from diagnose.robot.servos.motion import resolution, unit_payload
from diagnose.robot.servos.pipeline import ServoOutcome
from diagnose.robot.servos.state import JointSearch
from diagnose.robot.servos.whole import is_explained, judged, predictable
from mjsim.robot.closed_loop import ClosedLoop, closed_loop
from mjsim.robot.drives import JointDrive
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.write import carried_effects, write_robot
from mjsim.robot.write_servo import NewServo
from mjsim.servo import Servo, Target

__all__ = ["judge_servos", "write_corrected_servos"]


def write_corrected_servos(model: Path, robot: Robot, outcome: ServoOutcome, path: Path) -> None:
    """The corrected MJCF: gains, armature, damping, dry friction and springs in their elements, the rest carried."""
    joints: dict[str, dict[str, float]] = {}
    servos, carried = [], []
    for s in outcome.searches:
        if outcome.diagnosis.joints[s.problem.name].verdict.value == "no_mismatch":
            continue
        joints[s.problem.name], own = _joint_values(robot, s)
        carried += own
        d = s.problem.drive
        servos.append(
            NewServo(d.actuator, d.servo, new_servo(d, s.now.fit.slots, any("forcerange" in x.native for x in s.now.laws)))
        )
    links = robot.nominal - robot.fixed
    links[-1] += outcome.payload * unit_payload(robot)
    write_robot(model, robot, path, links, joints, carried, servos)


def new_servo(drive: JointDrive, p: np.ndarray, limited: bool) -> Servo:
    """The servo of slots (K,), at the actuator."""
    g = drive.gear
    kp, kv = float(p[SLOT["kp"]]) / g**2, float(p[SLOT["kv"]]) / g**2
    limit = float(p[SLOT["limit"]]) / abs(g) if limited else drive.servo.limit
    if drive.servo.target is Target.VELOCITY:
        return dataclasses.replace(drive.servo, kv=kv, limit=limit)
    return dataclasses.replace(drive.servo, kp=kp, kv=kv, zero=float(p[SLOT["zero"]]) * g, limit=limit)


def _joint_values(robot: Robot, s: JointSearch) -> tuple[dict[str, float], list[Mapping[str, Any]]]:
    """Attributes of the joint, and the effects that MJCF has no element for."""
    p, at = s.now.fit.slots, robot.leading(s.problem.joint)
    values = {}
    for name, own in (("armature", robot.armature[at]), ("damping", robot.damping[at])):  # tied joints keep what they have
        values[name] = max(float(p[SLOT[name]] - s.problem.nominal[SLOT[name]] + own), 0.0)
    carried: list[Mapping[str, Any]] = []
    own_friction = s.problem.nominal[SLOT["friction"]] > 0
    named = dict(zip(SLOT, map(float, p), strict=True))
    for law in s.now.laws:
        sprung = "stiffness" in law.native and float(robot.stiffness[at]) != 0.0  # the file's own spring stays
        if law.native and not sprung:
            values |= {key: float(p[SLOT[slot]]) for key, slot in law.native.items() if key != "forcerange"}
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


def judge_servos(
    outcome: ServoOutcome,
    robot: Robot,
    corrected: Path,
    recordings: Sequence[RobotRecording],
    held_out: Sequence[RobotRecording],
) -> RobotDiagnosis:
    """The diagnosis with the errors of both files as MuJoCo steps all joints together on the recorded commands.

    Figures of the fitting engine, one joint at a time, stand as "surrogate". Without held-out recordings the figures count all
    samples on both sides. Verdicts are those that these figures allow (`diagnose.robot.servos.whole`).
    """
    d = outcome.diagnosis
    effects = carried_effects(corrected)
    after = load_robot(corrected)
    runs = [_run(robot, r, ()) for r in (*recordings, *held_out)], [_run(after, r, effects) for r in (*recordings, *held_out)]
    roles = [False] * len(recordings) + [True] * len(held_out)
    joints: dict[str, JointResult] = {}
    table: dict[str, list[dict[str, Any]]] = {}
    for name, was in d.joints.items():
        j = robot.joints.index(name)
        both = [[_error(run, r, name, j) for run, r in zip(group, (*recordings, *held_out), strict=True)] for group in runs]
        fit = {key: _figures(errors, roles, [r.angle[:, r.joints.index(name)] for r in (*recordings, *held_out)])
               for key, errors in zip(("nominal", "corrected"), both, strict=True)}  # fmt: skip
        joints[name] = dataclasses.replace(
            was, fit={"nominal": fit["nominal"], "refitted": was.fit["refitted"], "corrected": fit["corrected"],
            "surrogate": was.fit["corrected"]}
        )  # fmt: skip
        table[name] = [
            {
                "file": r.source,
                "role": "held_out" if role else "estimation",
                "moves": _moves(r, name),
                "nominal_rms": _rms(a),
                "corrected_rms": _rms(b),
            }
            for r, role, a, b in zip((*recordings, *held_out), roles, *both, strict=True)
        ]
    joints = _judged(outcome, joints, runs[1], after, effects, (*recordings, *held_out))
    overall = {}
    for key in ("nominal", "refitted", "corrected", "surrogate"):
        own = [r.fit[key] for r in joints.values()]
        a, b = (math.sqrt(sum(getattr(f, k) ** 2 for f in own) / len(own)) for k in ("nrmse", "held_out_nrmse"))
        overall[key] = FitFigures(a, a, b, b)
    lacking = sorted({x for run in runs[1] for x in run.lacking})
    closed = {
        "engine": "MuJoCo, all joints together on the recorded commands, with the file's options and what corrected.xml carries",
        "joints": table, "lacking": lacking, "diverged": [any(run.diverged for run in group) for group in runs],
    }  # fmt: skip
    worst = max((r.verdict for r in joints.values()), key=ORDER.index)
    told = summary(worst, joints, d.changed)
    return dataclasses.replace(d, verdict=worst, summary=told, joints=joints, fit=overall, closed_loop=closed)


def _judged(
    outcome: ServoOutcome,
    joints: Mapping[str, JointResult],
    runs: Sequence[ClosedLoop],
    after: Robot,
    effects: Sequence[Mapping[str, Any]],
    recordings: Sequence[RobotRecording],
) -> dict[str, JointResult]:
    """The joints with the verdicts that the closed-loop runs of corrected.xml allow.

    MuJoCo's integration error is of first order in the timestep h and is no error of the model. Where an error at h holds
    structure, 2 e(h / 2) - e(h) is judged (Richardson extrapolation).
    """
    searches = [s for s in outcome.searches if s.problem.name in joints]
    errors = {s.problem.name: _joined(runs, recordings, s.problem.name, after) for s in searches}
    remains = {s.problem.name: predictable(s, errors[s.problem.name]) for s in searches}
    explained = {s.problem.name: is_explained(s, errors[s.problem.name], remains[s.problem.name]) for s in searches}
    if not all(explained[name] or joints[name].verdict is Verdict.UNEXPLAINED for name in joints):
        finer = [closed_loop(after, r, effects, finer=2) for r in recordings]
        for s in searches:
            name = s.problem.name
            if not explained[name]:
                e = 2.0 * _joined(finer, recordings, name, after) - errors[name]
                remains[name] = predictable(s, e)
                explained[name] = is_explained(s, e, remains[name])
    return {
        s.problem.name: judged(s, joints[s.problem.name], explained[s.problem.name], remains[s.problem.name]) for s in searches
    }


def _joined(runs: Sequence[ClosedLoop], recordings: Sequence[RobotRecording], name: str, robot: Robot) -> np.ndarray:
    """Errors (N,) of a joint in all recordings, one after the other."""
    j = robot.joints.index(name)
    return np.concatenate([_error(run, r, name, j) for run, r in zip(runs, recordings, strict=True)])


def _run(robot: Robot, r: RobotRecording, effects: Sequence[Mapping[str, Any]]) -> ClosedLoop:
    return closed_loop(robot, r, effects)


def _error(run: ClosedLoop, r: RobotRecording, name: str, j: int) -> np.ndarray:
    return np.asarray(r.angle[:, r.joints.index(name)] - run.z[:, j])


def _moves(r: RobotRecording, name: str) -> bool:
    q = r.angle[:, r.joints.index(name)]
    return bool(np.ptp(q) > LEAST_MOVED * resolution(q))


def _rms(e: np.ndarray) -> float | None:
    return float(np.sqrt(np.mean(e**2))) if np.isfinite(e).all() else None


def _figures(errors: Sequence[np.ndarray], roles: Sequence[bool], angles: Sequence[np.ndarray]) -> FitFigures:
    """Errors of all samples of fitted, and of held-out recordings (of all, where none is held out)."""
    out = []
    for role in (False, True) if any(roles) else (False, False):
        e = np.concatenate([x for x, r in zip(errors, roles, strict=True) if r == role])
        spread = math.sqrt(
            float(np.concatenate([(x - np.mean(x)) ** 2 for x, r in zip(angles, roles, strict=True) if r == role]).mean())
            + 1e-300
        )
        rms = float(np.sqrt(np.mean(e**2)))
        out += [rms, rms / spread]
    return FitFigures(out[0], out[1], out[2], out[3])
