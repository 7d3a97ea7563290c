"""Whether the dry friction of a servo joint holds it at rest, or lets it creep as in the user's simulator.

A machine sticks; MuJoCo's default settings let a loaded joint creep, and a log that was made with them shows it. The joint is
fitted with dry friction of both kinds, and the kind that leaves less counts for its search.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from diagnose.robot.servos.fit import Fit, Number, fit
from diagnose.robot.servos.library import scales_of
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.starts import THIN, regressed, start_fit
from diagnose.robot.servos.state import QUICK
from mjsim.robot.joint_kernel import SLOT

__all__ = ["with_fitting_friction"]

AMOUNTS = (0.05, 0.15, 0.5)  # of the rms torque of the drive: levels of dry friction from which the fits start


def with_fitting_friction(problem: JointProblem, numbers: tuple[Number, ...], start: Fit) -> tuple[JointProblem, Fit]:
    """The problem and its fit without effects, with the kind of dry friction that leaves less; ``start``: that fit as it is."""
    if not problem.softness[0] > 0.0:
        return problem, start
    hard, soft = (_least(problem.with_soft_friction(kind), numbers, start) for kind in (False, True))
    other = problem.with_soft_friction(soft < hard)
    if other.is_soft == problem.is_soft:
        return problem, start
    if problem.nominal[SLOT["friction"]] > 0.0:
        return other, start_fit(other, numbers)
    return other, dataclasses.replace(start, slots=_as(other, start))


def _as(problem: JointProblem, start: Fit) -> np.ndarray:
    """Slots (K,) of a fit with the kind of dry friction of a problem."""
    slots = start.slots.copy()
    for name in ("soft", "soft_rate"):
        slots[SLOT[name]] = problem.nominal[SLOT[name]]
    return slots


def _least(problem: JointProblem, numbers: tuple[Number, ...], start: Fit) -> float:
    """The smallest weighted sum of squares with dry friction beside the joint's own numbers, on a part of the samples."""
    free = numbers if any(n.slot == "friction" for n in numbers) else (*numbers, Number("friction"))
    part, begins = problem.windows(THIN), []
    for amount in AMOUNTS:
        slots = _as(problem, start)
        slots[SLOT["friction"]] = amount * scales_of(problem, slots).drive
        begins.append(slots)
    found = regressed(problem, True)
    begins += [found] if found is not None else []
    return min(fit(problem, free, slots, start.weights, QUICK, part).sse for slots in begins)
