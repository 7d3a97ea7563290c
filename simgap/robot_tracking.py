"""Robots that torques drive, all joints together in MuJoCo: the logged torques and a tracking loop that holds them to the
recording.

Torques alone drift: an arm is unstable in open loop. What the loop has to give is the error of the file as a torque, up to the
loop's
bandwidth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.robot.result import RobotDiagnosis
from mjsim.robot.closed_loop import TRACKING, ClosedLoop, closed_loop
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.write import carried_effects

__all__ = ["tracking_errors", "with_tracking"]

MOST_STEPS = 200_000  # of MuJoCo in one run of one recording; of a longer one its beginning is run
SETTLED = 1.0  # [s]: of a run that are not counted, until the loop has caught up


def with_tracking(
    d: RobotDiagnosis, robot: Robot, corrected: Path, recordings: Sequence[RobotRecording], held_out: Sequence[RobotRecording]
) -> RobotDiagnosis:
    """The diagnosis with ``closed_loop``: rms of the loop's torque by joint and recording, with the file as given and
    corrected.xml.

    Recordings with a payload are left out, since the files do not carry it.
    """
    effects, after = carried_effects(corrected), load_robot(corrected)
    table: dict[str, list[dict[str, Any]]] = {name: [] for name in d.joints}
    lacking: set[str] = set()
    diverged = [False, False]
    for k, r in enumerate((*recordings, *held_out)):
        if r.payload is not None:
            continue
        (before, first), (corrected_rms, second) = tracking_errors(robot, r, (), table), tracking_errors(after, r, effects, table)
        lacking |= set(second.lacking)
        diverged = [a or run.diverged for a, run in zip(diverged, (first, second), strict=True)]
        for name, rows in table.items():
            rows.append(
                {"file": r.source, "role": "estimation" if k < len(recordings) else "held-out", "moves": True,
                 "nominal_rms": before[name], "corrected_rms": corrected_rms[name]}
            )  # fmt: skip
    engine = f"MuJoCo, all joints together under the logged torques and a tracking loop of {TRACKING:g} Hz: torque of the loop"
    closed = {"engine": engine, "unit": "torque", "joints": table, "lacking": sorted(lacking), "diverged": diverged}
    return dataclasses.replace(d, closed_loop=closed)


def tracking_errors(
    robot: Robot, recording: RobotRecording, effects: Sequence[Mapping[str, Any]], joints: Iterable[str]
) -> tuple[dict[str, float | None], ClosedLoop]:
    """Rms of the loop's torque by joint, None where the run diverges, and the run; of a long recording that of its beginning."""
    samples = min(len(recording), max(2, int(MOST_STEPS * float(robot.model.opt.timestep) / recording.dt)))
    run = closed_loop(robot, recording, effects, samples)
    return {name: _rms(run, robot.joints.index(name), recording.dt) for name in joints}, run


def _rms(run: ClosedLoop, j: int, dt: float) -> float | None:
    if run.diverged:
        return None
    tracking = run.tracking[round(SETTLED / dt) :, j]
    return float(np.sqrt(np.mean(tracking**2))) if len(tracking) and np.isfinite(tracking).all() else None
