"""The file as given and corrected.xml of a servo robot in MuJoCo beside the log: figures and verdicts."""

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
from diagnose.robot.servos.pipeline import ServoOutcome
from diagnose.robot.servos.positions import resolution
from diagnose.robot.servos.state import JointSearch
from diagnose.robot.servos.whole import is_explained, judged, leaves_noise, predictable
from diagnose.thresholds import FAIR
from mjsim.robot.closed_loop import ClosedLoop, closed_loop
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.write import carried_effects

__all__ = ["coarse_joints", "given_runs", "judge_servos", "with_file_at_noise"]

AT_NOISE_AS_GIVEN = "The file as given leaves noise, all joints together in MuJoCo."


def given_runs(robot: Robot, recordings: Sequence[RobotRecording]) -> list[ClosedLoop]:
    """Runs of the file as given, all joints together on the recorded commands."""
    return [_run(robot, r, ()) for r in recordings]


def with_file_at_noise(
    outcome: ServoOutcome, robot: Robot, runs: Sequence[ClosedLoop], recordings: Sequence[RobotRecording]
) -> ServoOutcome:
    """The outcome where joints keep the numbers of the file that leaves noise in MuJoCo, if their numbers alone differ.

    The fit follows one joint along the smoothed motion of the others, and may change a number for an error of that motion.
    """
    joints, told = dict(outcome.diagnosis.joints), list(outcome.diagnosis.changed)
    if outcome.masses.selected:
        return outcome
    for s in outcome.searches:
        name = s.problem.name
        was = joints[name]
        error = _joined(runs, recordings, name, robot)
        if was.verdict is Verdict.PARAMETERS_ONLY and leaves_noise(s, error) and not _is_lowered(s, error):
            joints[name] = dataclasses.replace(was, verdict=Verdict.NO_MISMATCH, summary=f"{AT_NOISE_AS_GIVEN} {was.summary}")
            told = [line for line in told if f" of {name}: " not in line and f" behind {name}: " not in line]
    worst = max((r.verdict for r in joints.values()), key=ORDER.index)
    d = dataclasses.replace(
        outcome.diagnosis, verdict=worst, summary=summary(worst, joints, told), joints=joints, changed=tuple(told)
    )
    return dataclasses.replace(outcome, diagnosis=d)


def coarse_joints(
    outcome: ServoOutcome, robot: Robot, runs: Sequence[ClosedLoop], recordings: Sequence[RobotRecording]
) -> tuple[str, ...]:
    """Joints with no mismatch of which the file leaves more than noise as MuJoCo steps it, and the joint's fit clearly less."""
    out = []
    for s in outcome.searches:
        error = _joined(runs, recordings, s.problem.name, robot)
        stands = outcome.diagnosis.joints[s.problem.name].verdict is Verdict.NO_MISMATCH
        if stands and np.isfinite(error).all() and not leaves_noise(s, error) and _is_lowered(s, error):
            out.append(s.problem.name)
    return tuple(out)


def _is_lowered(s: JointSearch, error: np.ndarray) -> bool:
    """Whether the fit of a joint takes a quarter off the held-out squared closed-loop error (N,) of the file as given."""
    held = s.problem.held
    return float(np.mean(s.now.fit.error[held] ** 2)) < (1.0 - FAIR) * float(np.mean(error[held] ** 2))


def judge_servos(
    outcome: ServoOutcome,
    robot: Robot,
    corrected: Path,
    recordings: Sequence[RobotRecording],
    held_out: Sequence[RobotRecording],
    by_motion: Path | None = None,
    given: Sequence[ClosedLoop] | None = None,
) -> RobotDiagnosis:
    """The diagnosis with the errors of both files as MuJoCo steps all joints together on the recorded commands.

    by_motion: the corrected file with the numbers of the motion, where those of ``corrected`` take up the integration error;
    given: the runs of the file as given, where there are.

    Figures of the fitting engine, one joint at a time, stand as "surrogate". Without held-out recordings the figures count all
    samples on both sides. Verdicts are those that these figures allow (`diagnose.robot.servos.whole`).
    """
    d = outcome.diagnosis
    effects = carried_effects(corrected)
    after = load_robot(corrected)
    runs = list(given or given_runs(robot, (*recordings, *held_out))), [_run(after, r, effects) for r in (*recordings, *held_out)]
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
                "role": "held-out" if role else "estimation",
                "moves": _moves(r, name),
                "nominal_rms": _rms(a),
                "corrected_rms": _rms(b),
            }
            for r, role, a, b in zip((*recordings, *held_out), roles, *both, strict=True)
        ]
    joints = _judged(outcome, joints, runs[1], after, by_motion or corrected, (*recordings, *held_out))
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
    by_motion: Path,
    recordings: Sequence[RobotRecording],
) -> dict[str, JointResult]:
    """The joints with the verdicts that the closed-loop runs of corrected.xml allow.

    MuJoCo's integration error is of first order in the timestep h and is no error of the model. Where an error at h holds
    structure, 2 e(h / 2) - e(h) of the file with the numbers of the motion is judged (Richardson extrapolation).
    """
    searches = [s for s in outcome.searches if s.problem.name in joints]
    errors = {s.problem.name: _joined(runs, recordings, s.problem.name, after) for s in searches}
    remains = {s.problem.name: predictable(s, errors[s.problem.name]) for s in searches}
    explained = {s.problem.name: is_explained(s, errors[s.problem.name], remains[s.problem.name]) for s in searches}
    noise = {s.problem.name: leaves_noise(s, errors[s.problem.name]) for s in searches}
    if not all(explained[name] or joints[name].verdict is Verdict.UNEXPLAINED for name in joints):
        other, effects = load_robot(by_motion), carried_effects(by_motion)
        steps, finer = ([closed_loop(other, r, effects, finer=k) for r in recordings] for k in (1, 2))
        for s in searches:
            name = s.problem.name
            if not explained[name]:
                e = 2.0 * _joined(finer, recordings, name, after) - _joined(steps, recordings, name, after)
                remains[name] = predictable(s, e)
                explained[name] = is_explained(s, e, remains[name])
    return {
        s.problem.name: judged(
            s, joints[s.problem.name], explained[s.problem.name], remains[s.problem.name], noise=noise[s.problem.name]
        )
        for s in searches
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
