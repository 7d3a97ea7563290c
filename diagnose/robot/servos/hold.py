"""How the commands of a robot go between samples, where nobody stated it: one controller sends them all.

The rule is that of one joint (`diagnose.fit.command_hold`): no servo is early, so that an error which falls where the commands
act earlier, and grows again for what is earlier still, is the hold's.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from diagnose.fit.command_hold import earlier
from diagnose.problem.noise_model import ModelError
from diagnose.robot.servos.fit import Fit, Number, block_weights, fit, independent
from diagnose.robot.servos.library import PROFILE, servo_laws
from diagnose.robot.servos.motion import JointProblem, Motion, joint_problem, moving, prepare
from diagnose.robot.servos.starts import THIN, own_numbers, start_fit
from diagnose.robot.servos.state import QUICK, JointSearch
from diagnose.thresholds import FAIR, MATERIAL
from mjsim.hold import HOLDS
from mjsim.robot.joint_kernel import SLOT
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.servo import Target

__all__ = ["shown_hold"]

Change = Callable[[RobotRecording], RobotRecording]


def shown_hold(robot: Robot, recordings: Sequence[RobotRecording], found: Sequence[JointSearch] = ()) -> str:
    """The hold that lowers the squared error of held commands in the mean over the joints and raises it at none, by a material
    part each; "held" where none does.

    found: searches under held commands, whose structures are refitted under each hold; without them the numbers of the file are,
    dry friction or a limited acceleration beside them. Raises InputError.
    """
    motions = [prepare(robot, r, False, {}) for r in recordings]
    held = [p for n in moving(robot, recordings) if (p := _problem(robot, motions, n)) is not None]
    known = {s.problem.name: s for s in found}
    if known:
        held = [known[p.name].problem.carried_to(p) for p in held if p.name in known]
    fits = [_Joint.found(p, known[p.name]) if known else _Joint.of(p) for p in held]
    if not fits:
        return "held"

    def left(change: Change) -> tuple[float, float, float]:
        """Mean and least over the joints of log(error held / error changed), and the gain over all independent samples."""
        moved = [dataclasses.replace(m, recording=change(m.recording)) for m in motions]
        logs, gain = [], 0.0
        for joint in fits:
            problem = _problem(robot, moved, joint.problem.name)
            assert problem is not None
            problem = joint.problem.carried_to(problem)
            ratio, count = joint.compared(problem)
            logs.append(ratio)
            gain += count * ratio
        return float(np.mean(logs)), min(logs), gain

    by_hold = {hold: left(partial(dataclasses.replace, hold=hold)) for hold in HOLDS if hold != "held"}
    best = max(by_hold, key=lambda hold: by_hold[hold][0])
    ratio, least, gain = by_hold[best]
    if ratio < MATERIAL or least < -MATERIAL or gain < ModelError.prices.entry:
        return "held"
    return "held" if best == "mean" and left(earlier)[0] > ratio else best


@dataclasses.dataclass(frozen=True, eq=False)
class _Joint:
    """One joint under held commands, its fit beside dry friction, and the weights (N,) of its samples."""

    problem: JointProblem
    numbers: tuple[Number, ...]
    fit: Fit
    weights: np.ndarray

    @classmethod
    def of(cls, problem: JointProblem) -> _Joint:
        """Fitted from the file's numbers, then with dry friction from a small part of the drive's torque, or with a limited
        acceleration where that takes a quarter off the squared error."""
        numbers = own_numbers(problem)
        first = start_fit(problem, numbers)
        if "friction" in {n.slot for n in numbers}:
            return cls(problem, numbers, first, block_weights(problem, first.error))
        slots = first.slots.copy()
        drive = slots[SLOT["kv" if problem.drive.velocity else "kp"]] * float(np.std(problem.first - problem.angle))
        slots[SLOT["friction"]] = 0.1 * drive
        weights, part = block_weights(problem, first.error), problem.windows(THIN)
        beside = (*numbers, Number("friction"))
        found = fit(problem, beside, slots, weights, QUICK, part)
        if not problem.drive.velocity:  # a profile moves a joint by more than half a sample
            law = next(x for x in servo_laws(problem, first.slots, (PROFILE,)) if x.id == PROFILE)
            starts = [problem.nominal.copy() for _ in law.starts]
            for start, values in zip(starts, law.starts, strict=True):
                for name, value in values.items():
                    start[SLOT[name]] = value
            begun = min(starts, key=lambda x: float(np.sum(part.error(x)[part.fitted] ** 2)))
            best = fit(problem, (*numbers, *law.numbers), begun, weights, QUICK, part)
            if best.sse < (1.0 - FAIR) * found.sse:
                beside, found = best.numbers, best
        return cls(problem, beside, found, block_weights(problem, found.error))

    @classmethod
    def found(cls, problem: JointProblem, s: JointSearch) -> _Joint:
        """Fitted from the structure of a search."""
        start = s.now.fit
        weights = block_weights(problem, problem.error(start.slots))
        found = fit(problem, start.numbers, start.slots, weights, QUICK, problem.windows(THIN))
        return cls(problem, start.numbers, found, weights)

    def compared(self, problem: JointProblem) -> tuple[float, float]:
        """log(error held / error) of the same joint with its command changed, refitted, and the number of independent samples."""
        other = fit(problem, self.numbers, self.fit.slots, self.weights, QUICK, problem.windows(THIN))
        mask, w2 = problem.fitted, self.weights[problem.fitted] ** 2
        a, b = self.fit.error[mask], other.error[mask]
        least = float(np.sum(w2)) * problem.noise**2
        ratio = math.log(max(float(w2 @ a**2), least) / max(float(w2 @ b**2), least))
        return ratio, independent(b, problem.dt, a - b) * len(a)


def _problem(robot: Robot, motions: Sequence[Motion], name: str) -> JointProblem | None:
    """The problem of one joint; None where its command is integrated, which has no hold, or nothing is fitted."""
    problem = joint_problem(robot, motions, name, False)
    return None if problem.drive.servo.target is Target.INTEGRATED or not problem.fitted.any() else problem
