"""Further searches of a servo robot's joints, beside the user's simulator in place of each joint's own run.

The search runs one joint at a time along the smoothed, recorded motion of the others; what that leaves out limits how small an
effect can be. The run of the whole robot in MuJoCo leaves nothing out. The difference of the two runs of the answer is on the
side of the models in the next search,

    y - [S(theta) + M(theta_0) - S(theta_0)],    M: the robot in MuJoCo, S: the joint's own run, theta_0: the answer,

M extrapolated to no timestep (Richardson), so that numbers stay those of the motion. Source: M. C. Kennedy, A. O'Hagan, J. R.
Stat. Soc. B 63 (2001) 425, as for one axis (`diagnose.verdict.reference_stage`).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from diagnose.result import Verdict
from diagnose.robot.options import RobotOptions
from diagnose.robot.servos.pipeline import ServoOutcome, search_beside
from diagnose.robot.servos.state import JointSearch
from diagnose.thresholds import TWICE
from diagnose.verdict.reference_stage import APART
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.write import carried_effects
from simgap.robot_written import write_corrected_servos

__all__ = ["beside_simulator"]

ROUNDS = 3  # searches beside the simulator at most: each takes the difference out to first order


def beside_simulator(
    outcome: ServoOutcome, model: Path, robot: Robot, recordings: tuple[Sequence[RobotRecording], Sequence[RobotRecording]],
    options: RobotOptions, say: Callable[[str], None],
) -> ServoOutcome:  # fmt: skip
    """The outcome of further searches, as long as the two runs of a joint that is not as in the file are apart.

    recordings: fitted, held out. Two runs are apart where the mean square of their difference, beside the shift of the search
    before, exceeds 4 % of the variance of the noise, and of the joint's error where that is larger. The outcome stays as it is
    where no joint is apart, where the robot diverges and where the budget is used up.
    """
    for _ in range(ROUNDS):
        joints = outcome.diagnosis.joints
        if options.late or all(r.verdict is Verdict.NO_MISMATCH for r in joints.values()):
            return outcome
        runs = _runs(outcome, model, robot, (*recordings[0], *recordings[1]))
        if runs is None:
            return outcome
        shifts = {s.problem.name: _shift(s, runs[s.problem.name]) for s in outcome.searches}
        differ = [s for s in outcome.searches if joints[s.problem.name].verdict is not Verdict.NO_MISMATCH]
        apart = [s.problem.name for s in differ if _is_apart(s, shifts)]
        if not apart:
            return outcome
        say(f"again, beside MuJoCo: {', '.join(apart)}")
        outcome = search_beside(robot, outcome, shifts, *recordings, options, say)
    return outcome


def _runs(outcome: ServoOutcome, model: Path, robot: Robot, recordings: Sequence[RobotRecording]) -> dict[str, np.ndarray] | None:
    """Positions (N,) by joint of corrected.xml in MuJoCo, extrapolated to no timestep; None where a run diverges."""
    with tempfile.TemporaryDirectory() as work:
        path = Path(work) / "corrected.xml"
        write_corrected_servos(model, robot, outcome, path)
        after, effects = load_robot(path), carried_effects(path)
    parts = []
    for r in recordings:
        steps, finer = (closed_loop(after, r, effects, finer=k) for k in (1, 2))
        if steps.diverged or finer.diverged:
            return None
        parts.append(2.0 * finer.z - steps.z)
    z = np.concatenate(parts)
    return {s.problem.name: z[:, after.joints.index(s.problem.name)] for s in outcome.searches}


def _shift(s: JointSearch, run: np.ndarray) -> np.ndarray:
    """What the robot's run (N,) is beyond the joint's own; zeros where it follows the recording less well by a factor of two."""
    p = s.problem
    own, counted = p.run(s.now.fit.slots)[0], p.fitted | p.held
    errors = [float(np.sum((p.angle - q)[counted] ** 2)) for q in (run, own)]
    return run - own if errors[0] < TWICE * errors[1] else np.zeros(len(own))


def _is_apart(s: JointSearch, shifts: dict[str, np.ndarray]) -> bool:
    """Whether a shift differs from the one that the search had, by a part of the noise and of the error that the joint has."""
    p = s.problem
    more = shifts[p.name] if p.shift is None else shifts[p.name] - p.shift
    moved, error = (float(np.sqrt(np.mean(x[p.fitted | p.held] ** 2))) for x in (more, s.now.fit.error))
    return moved > APART * max(p.noise, error)
