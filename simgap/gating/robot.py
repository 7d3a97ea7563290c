"""The gate of a robot: all joints together in MuJoCo, as its diagnosis ran them, with the model of today."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from diagnose.data.listed import as_taken
from mjsim.errors import InputError, nearest
from mjsim.quantity import Motion
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.recording import RobotRecording, load_robot_recording
from mjsim.robot.write import carried_effects
from simgap.gating.check import Baseline, Check, of_the_baseline, ratio_of
from simgap.robot import by_servo
from simgap.robot_tracking import tracking_errors

__all__ = ["judged"]


def judged(model: Path, recordings: Sequence[Path], known: Baseline, tolerance: float) -> list[Check]:
    """Checks of each joint that moves, on each recording, against a baseline's figures. Raises InputError.

    Servos: error of the position on the recorded commands. Torques: torque of the loop that holds the joints to the recording.
    """
    robot = load_robot(model)
    effects = carried_effects(model)
    checks: list[Check] = []
    for path in recordings:
        r = as_taken(load_robot_recording(path, robot, model=model), known.holds)
        for role in of_the_baseline(r.source, r.sha256, known):
            before = {n: rows[r.sha256, role] for n, rows in known.joints.items() if (r.sha256, role) in rows}
            if not before:
                raise InputError(
                    r.source, f"{known.path} has no errors of joints on it",
                    "a recording in which a joint moves, without a payload",
                    "leave it out",
                )  # fmt: skip
            now = _errors(robot, r, effects)
            checks += [_check(robot, r, role, name, now, x, tolerance) for name, x in before.items()]
    return checks


def _errors(robot: Robot, r: RobotRecording, effects: Sequence[Mapping[str, object]]) -> dict[str, tuple[float, bool]]:
    """(rms error, whether it is a torque) of each joint; infinite where the run diverges."""
    if not by_servo(robot, [r]):
        found, _ = tracking_errors(robot, r, effects, r.joints)
        return {name: (math.inf if x is None else x, True) for name, x in found.items()}
    run = closed_loop(robot, r, effects)
    out = {}
    for k, name in enumerate(r.joints):
        e = r.angle[:, k] - run.z[:, robot.joints.index(name)]
        out[name] = (float(np.sqrt(np.mean(e**2))) if np.isfinite(e).all() else math.inf, False)
    return out


def _check(
    robot: Robot, r: RobotRecording, role: str, name: str, now: Mapping[str, tuple[float, bool]], before: float, tolerance: float
) -> Check:
    if name not in now:
        raise InputError(
            r.source, f"the model or the log has no joint {name!r}, which the baseline has", f"one of {', '.join(now)}",
            nearest(name, now, "run simgap diagnose for a new baseline"),
        )  # fmt: skip
    rms, torque = now[name]
    slide = robot.motions[robot.joints.index(name)] is Motion.SLIDE
    unit = ("N" if slide else "N m") if torque else ("m" if slide else "rad")
    ratio = ratio_of(rms, before)
    return Check((r.source,), role, rms, before, ratio, not ratio <= 1 + tolerance, unit, name)
