"""The own numbers of servo joints as the user's simulator needs them: a last fit of corrected.xml in MuJoCo's closed loop.

The fitting engine integrates one joint at a time to second order. MuJoCo steps all joints together, to first order in its
timestep h: the motion leads by about h / 2, which a servo's damping larger by kp h / 2 takes up. Gauss-Newton with Levenberg's
damping on the fitted samples, the error by MuJoCo and the Jacobian by the engine, as for one axis
(`diagnose.verdict.reference_fit`). Effects keep their numbers, which are those of the motion.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diagnose.robot.servos.fit import Number, jacobian, slots_of, start_of
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.pipeline import ServoOutcome
from diagnose.robot.servos.state import JointSearch
from mjsim.robot.closed_loop import closed_loop
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot, load_robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.write import carried_effects
from simgap.robot_written import write_corrected_servos

__all__ = ["Polish", "polish_servos", "stepped"]

OWN = ("kp", "kv", "damp", "damping", "armature", "zero")  # numbers that MJCF has elements for, of the joint itself
ROUNDS = 4  # steps at most; the engine's Jacobian is that of MuJoCo but for its integration error, so that one or two do
DAMPINGS = (1e-3, 1e-1)  # of the diagonal of the normal equations, in turn until the loss falls
LARGEST = 0.5  # change of a coded number in a step
ENOUGH = 0.01  # relative decrease of the loss below which no further step is tried
MOST_STEPS = 200_000  # of MuJoCo in one run: longer recordings are run by their first parts
TOLD = 0.01  # relative change of a number that is told

Slots = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Polish:
    """Slots (K,) by joint to write in corrected.xml, and what they change, in words."""

    slots: Mapping[str, np.ndarray]
    notes: tuple[str, ...]


def polish_servos(
    model: Path, robot: Robot, outcome: ServoOutcome, recordings: Sequence[RobotRecording], coarse: Collection[str] = ()
) -> Polish:
    """The numbers with the least closed-loop error on the fitted samples of ``recordings``, from those of the diagnosis on.

    coarse: joints of which the file stands by the equations, and not as MuJoCo steps it; they are fitted too. Without change
    where the closed loop errs no more than the joints one at a time do, and where it diverges.
    """
    joints = outcome.diagnosis.joints
    searches = [s for s in outcome.searches if s.problem.name in coarse or joints[s.problem.name].verdict.value != "no_mismatch"]
    now: Slots = {s.problem.name: s.now.fit.slots for s in searches}
    run = _Runs(model, robot, outcome, recordings)
    errors = run(now)
    if errors is None or _loss(searches, errors) < (1 + ENOUGH) * _loss(
        searches, {s.problem.name: s.now.fit.error for s in searches}
    ):
        return Polish({name: slots for name, slots in now.items() if name not in coarse}, ())
    for _ in range(ROUNDS):
        before = _loss(searches, errors)
        for damping in DAMPINGS:
            trial = {s.problem.name: _stepped(s, now[s.problem.name], errors[s.problem.name], damping) for s in searches}
            found = run(trial)
            if found is not None and _loss(searches, found) < before:
                now, errors = trial, found
                break
        if before - _loss(searches, errors) < ENOUGH * before:
            break
    return Polish(now, _told(searches, now, float(robot.model.opt.timestep)))


class _Runs:
    """Closed-loop errors (N,) by joint of corrected.xml with given slots; None where the run diverges.

    They are zero where nothing is run: on held-out recordings and behind the first parts of long ones.
    """

    def __init__(self, model: Path, robot: Robot, outcome: ServoOutcome, recordings: Sequence[RobotRecording]) -> None:
        self.model, self.robot, self.outcome, self.recordings = model, robot, outcome, recordings
        h = float(robot.model.opt.timestep)
        steps = sum(len(r) * max(1, math.ceil(r.dt / h - 1e-6)) for r in recordings)
        self.part = min(1.0, MOST_STEPS / steps)

    def __call__(self, slots: Slots) -> Slots | None:
        with tempfile.TemporaryDirectory() as work:
            path = Path(work) / "corrected.xml"
            write_corrected_servos(self.model, self.robot, self.outcome, path, slots)
            after, effects = load_robot(path), carried_effects(path)
        out = {s.problem.name: np.zeros(len(s.problem.angle)) for s in self.outcome.searches}
        for k, r in enumerate(self.recordings):
            n = max(2, round(self.part * len(r)))
            made = closed_loop(after, r, effects, n)
            if made.diverged:
                return None
            for s in self.outcome.searches:
                j, p = after.joints.index(s.problem.name), s.problem
                start = int(p.starts[k])
                out[p.name][start : start + n] = r.angle[:n, r.joints.index(p.name)] - made.z[:n, j]
        return out


def _loss(searches: Sequence[JointSearch], errors: Mapping[str, np.ndarray]) -> float:
    """Weighted sum of the squared errors (N,) of all joints on the fitted samples, by the weights of their fits."""
    return sum(float(np.sum((s.weights * errors[s.problem.name])[s.problem.fitted] ** 2)) for s in searches)


def _stepped(s: JointSearch, slots: np.ndarray, error: np.ndarray, damping: float) -> np.ndarray:
    """Slots after one step of the joint's own numbers, see `stepped`."""
    numbers = tuple(n for n in s.now.fit.numbers if n.slot in OWN)
    return stepped(s.problem, numbers, slots, s.now.fit.slots, error, s.weights, damping)


def stepped(
    problem: JointProblem,
    numbers: Sequence[Number],
    slots: np.ndarray,
    found: np.ndarray,
    error: np.ndarray,
    weights: np.ndarray,
    damping: float,
) -> np.ndarray:
    """Slots (K,) after one damped Gauss-Newton step of numbers against an error (N,), with the joint's own Jacobian.

    A number with a prior has one of the same width about its value in the slots ``found``, so that combinations that the
    motion does not show stay.
    """
    if not numbers:
        return slots
    x, center = start_of(numbers, slots), start_of(numbers, found)
    part = problem.with_fitted()
    own = weights[part.rows]
    J = jacobian(part, numbers, x, slots, own)[: int(part.fitted.sum())]
    prior = np.array([0.0 if n.prior is None else n.prior[1] ** -2 for n in numbers])
    H = J.T @ J + np.diag(prior)
    g = J.T @ (own * error[part.rows])[part.fitted] + prior * (x - center)
    step = -np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-9 * np.trace(H) + 1e-30), g)
    return slots_of(problem, numbers, x + np.clip(step, -LARGEST, LARGEST), slots)


def _told(searches: Sequence[JointSearch], now: Slots, timestep: float) -> tuple[str, ...]:
    """Which numbers of corrected.xml differ from those of the motion, and why."""
    out = []
    for s in searches:
        for name, slot in (("kp", ("kp",)), ("kv + damping", ("kv", "damping")), ("armature", ("armature",))):
            was, value = (sum(float(p[SLOT[x]]) for x in slot) for p in (s.now.fit.slots, now[s.problem.name]))
            if abs(value - was) > TOLD * abs(was):
                out.append(f"{name} of {s.problem.name} {was:.4g} -> {value:.4g}")
    if not out:
        return ()
    return (
        f"corrected.xml takes up MuJoCo's integration error at the file's timestep ({1e3 * timestep:g} ms): {', '.join(out)}. "
        "The values of the diagnosis are those of the motion; refit at another timestep.",
    )
