"""Replay of a robot: all joints of a file together in MuJoCo on the input of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.data.listed import as_taken, holds_beside
from mjsim.errors import InputError
from mjsim.quantity import Motion
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.model import load_robot
from mjsim.robot.recording import load_robot_recording
from mjsim.robot.write import carried_effects
from mjsim.writers import write_table

__all__ = ["RobotReplay", "replay_robot"]


@dataclass(frozen=True)
class RobotReplay:
    """Errors of a replay by joint: rms [rad | m], nrmse over the spread of the measured position; effects that ran, and that
    did not; what was taken from the diagnosis beside the file."""

    joints: dict[str, dict[str, Any]]
    effects: tuple[str, ...]
    lacking: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """As ``simgap replay --json`` prints it: the joints, and over all of them the rms of their errors over their spreads."""
        nrmse = float(np.sqrt(np.mean([r["nrmse"] ** 2 for r in self.joints.values()])))
        rms = float(np.sqrt(np.mean([r["rms"] ** 2 for r in self.joints.values()])))
        return {
            "rms": rms, "nrmse": nrmse, "fit_percent": 100.0 * (1.0 - nrmse), "channel": "angle", "engine": "mujoco",
            "joints": self.joints, "effects": list(self.effects), "lacks": list(self.lacking),
        }  # fmt: skip


def replay_robot(model: Path, recording: Path, out: Path) -> RobotReplay:
    """Step all joints on the recorded commands or torques, with what the file carries, and write their motion to ``out``.

    Joints that a torque drives are held to the recording by a tracking loop, whose torque is a column. Raises InputError for a
    run that
    diverges.
    """
    robot = load_robot(model)
    given = load_robot_recording(recording, robot, model=model)
    r = as_taken(given, holds_beside(model))
    effects = carried_effects(model)
    run = closed_loop(robot, r, effects)
    if run.diverged:
        raise InputError(model, "the run diverges", "a file that MuJoCo can step on this recording", "make the timestep smaller")
    columns: dict[str, np.ndarray] = {"time_s": r.time}
    joints: dict[str, dict[str, Any]] = {}
    for j, name in enumerate(robot.joints):
        angle, speed, torque = ("rad", "rad_s", "Nm") if robot.motions[j] is Motion.HINGE else ("m", "m_s", "N")
        columns[f"{name}.angle_{angle}"], columns[f"{name}.velocity_{speed}"] = run.z[:, j], run.dz[:, j]
        tracked = bool(np.isfinite(run.tracking[0, j]))
        if tracked:
            columns[f"{name}.tracking_{torque}"] = run.tracking[:, j]
        if name in r.joints:
            measured = r.angle[:, r.joints.index(name)]
            rms = float(np.sqrt(np.mean((measured - run.z[:, j]) ** 2)))
            spread = float(np.std(measured))
            if spread > 0:
                joints[name] = {"rms": rms, "nrmse": rms / spread, "unit": angle}
                if tracked:
                    joints[name]["tracking_rms"] = float(np.sqrt(np.mean(run.tracking[:, j] ** 2)))
    if not joints:
        raise InputError(recording, "no joint moves", "a recording in which a joint moves", "record a motion")
    write_table(out, columns)
    ran = tuple(f"{e['effect']} at {e['joint']}" for e in effects)
    return RobotReplay(joints, tuple(x for x in ran if x not in run.lacking), run.lacking, r.notes[len(given.notes) :])
