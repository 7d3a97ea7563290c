"""Which effects, at which joints: forward selection over the whole robot, exchange and removal, each step held to unseen data.

Candidates are (joint, law, shape). Their gain is screened at once, by projection on what the fitted columns do not span; the
few best laws are refitted with everything else free. One enters when it pays on the fitted samples (extended BIC, J. Chen,
Z. Chen, Biometrika 95 (2008) 759), is physical, and predicts held-out samples better: paired block tests, with the family-wise
error over all joints and laws held below the level.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from diagnose.robot.laws import Law, law_parameters
from diagnose.robot.options import RobotOptions
from diagnose.robot.physical import physical
from diagnose.robot.problem import Problem, Term
from diagnose.robot.solve import Solution, covariance, solve, weigh
from diagnose.robot.state import Refusal, Selection, replaced, screen, size
from diagnose.thresholds import EQUIVALENT

__all__ = ["select"]

FINALISTS = 5  # laws of a joint that are refitted: those with the largest gain in the screening
PROMISING = 0.5  # of what is needed to enter: a promise is the gain of one row alone
ROUNDS = 40  # moves at most: each lowers the criterion, so that it ends by itself
UNSIGNED = ("phase_rad", *(f"coefficient_{k}" for k in range(5)))  # zero is a value like any other
NOT_PHYSICAL = "its coefficients are not physical"
STAYS = 5.0  # times the level to enter, at which a term stays: what enters at 1 % may stay at 5 %


def select(problem: Problem, options: RobotOptions) -> Selection:
    """Search for the effects. The selection's solution is the last one; its terms are what was found."""
    rows = problem.rows(problem.nominal)
    weights, solution = weigh(problem, (), rows)
    solution = physical(problem, solution, weights)
    found = Selection(problem, options, problem.rows(solution.theta), weights, solution)
    for _ in range(ROUNDS):
        if options.late:
            break
        found.visited.add(frozenset(t.key for t in found.solution.terms))
        if not (
            _enter(found, simple=True) or _enter(found, simple=False) or _exchange(found) or _remove(found) or _reduce(found)
        ):
            break
        _reweigh(found)
    return found


def _reweigh(s: Selection) -> None:
    """Take the load and the weights from the present solution, and solve anew."""
    s.rows = s.problem.rows(s.solution.theta)
    for term in [t for t in s.cache if t.law.loaded]:
        del s.cache[term]
    s.weights, solution = weigh(s.problem, s.solution.terms, s.rows)
    s.solution = s.physical(solution)
    s.fill(s.solution.terms)


def _eligible(s: Selection, joint: int, law: Law) -> bool:
    """Whether a law is simple, or refines one that stands at the joint."""
    return not law.holds or any(t.joint == joint and t.law.id in law.holds for t in s.solution.terms)


def _enter(s: Selection, simple: bool) -> bool:
    """Let at each joint the best candidate enter that passes; remember why the others do not.

    simple: laws that refine none, or one that stands at the joint already; else all of them.
    """
    entry = 2.0 * math.log(s.candidates)
    entered = False
    for joint in s.problem.joints:
        if len(s.solution.terms) >= s.options.most or s.options.late:
            break
        ranked = [
            x for x in screen(s, s.solution, joint) if (not simple or _eligible(s, joint, x[1].law)) and x[1].key not in s.removed
        ]
        best: tuple[float, Solution, Term] | None = None
        for promised, term in ranked[:FINALISTS]:
            if promised < PROMISING * entry:
                break
            trial = s.solve(replaced(s.solution.terms, term))
            if s.known(trial):
                continue
            trial = s.reweighed(trial, joint)
            step = s.step(s.solution, trial, joint)
            why = s.why_not(step, term.law, 1) if trial.sane(term) else NOT_PHYSICAL
            if why:
                s.refusals[term.key] = Refusal(joint, term.law, why, step)
            elif best is None or step.total > best[0]:
                best = step.total, trial, term
        if best is not None:
            s.solution, entered = _one_friction(s, _refined(s, best[1], best[2]), joint), True
    return entered


def _one_friction(s: Selection, now: Solution, joint: int) -> Solution:
    """Laws of one joint as the one law that is their sum, where that is physical.

    Dry friction and a smaller offset are asymmetric friction.
    """
    own = {t.law.id for t in now.terms if t.joint == joint}
    law = next((x for x in s.problem.laws[joint] if x.is_sum and set(x.holds) <= own), None)
    if law is None:
        return now
    new = Term(joint, law, law.grid[0])
    merged = s.solve(replaced(now.terms, new))
    return merged if merged.sane(new) else now


def _refined(s: Selection, now: Solution, term: Term) -> Solution:
    """The solution with the shape of one term refined between its neighbours on the grid."""
    from scipy.optimize import minimize_scalar

    law = term.law
    if not law.shape_name:
        return now
    grid = sorted({*law.grid, *law.limits})
    at = int(np.searchsorted(grid, term.shape))
    low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
    low, high = max(low, law.limits[0]), min(high, law.limits[1])
    others = {t: s.columns(t) for t in now.terms if t != term}

    def with_shape(shape: float) -> Solution:
        new = dataclasses.replace(term, shape=float(shape))
        terms = tuple(new if t == term else t for t in now.terms)
        return solve(s.problem, terms, s.weights, s.rows, others | {new: s.problem.columns(new, s.rows)})

    def cost(shape: float) -> float:
        trial = with_shape(shape)
        return sum(len(trial.fitted[j]) * math.log(trial.sse(j) + 1e-300) for j in s.problem.joints)

    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 3e-3 * (high - low), "maxiter": 12})
    trial = s.physical(with_shape(float(found.x)))
    return trial if trial.sane(term) and found.fun < cost(term.shape) else now


def _exchange(s: Selection) -> bool:
    """Put another law in the place of a term where that is clearly better, or as good with fewer numbers."""
    for term in s.solution.terms:
        rest = s.solve([t for t in s.solution.terms if t != term])
        for _, other in screen(s, rest, term.joint)[:FINALISTS]:
            if other.law.key == term.law.key or any(t.joint == term.joint and t.law.id == other.law.id for t in rest.terms):
                continue
            trial = s.solve(replaced(rest.terms, other))
            if s.step(s.solution, trial, term.joint).total > -2 * EQUIVALENT:
                trial = _refined(s, trial, other)
            if trial.sane(other) and not s.known(trial) and _better(s, trial, other):
                s.solution = trial
                return True
    return False


def _better(s: Selection, trial: Solution, new: Term) -> bool:
    """Whether another law at a joint is to take the place of the present one.

    With fewer numbers it must not lose, on fitted and held-out samples together and less the price; with as many it must be
    clearly
    ahead, and on either; with more it must pass what an effect must pass to enter.
    """
    more = size(trial.terms) - size(s.solution.terms)
    step = s.step(s.solution, trial, new.joint)
    if more < 0:
        return step.total > 0.0
    if more == 0:
        return step.total > EQUIVALENT and min(s.raw_gain(s.solution, trial), step.likelihood) > 0.0
    return step.total > EQUIVALENT and not s.why_not(step, new.law, more)


def _remove(s: Selection) -> bool:
    """Take off the least term that no longer pays beside the others; it does not come back."""
    worst: tuple[float, Solution] | None = None
    taken = Term(0, s.problem.laws[s.problem.joints[0]][0], 0.0)
    for term in s.solution.terms:
        without = s.solve([t for t in s.solution.terms if t != term])
        step = s.step(without, s.solution, term.joint)
        why = s.why_not(step, term.law, 1, STAYS) if s.solution.sane(term) else NOT_PHYSICAL
        if why and (worst is None or step.gain < worst[0]):
            worst = step.gain, without
            taken = term
            s.refusals[term.key] = Refusal(term.joint, term.law, f"beside the other findings: {why}", step)
    if worst is None:
        return False
    s.solution = worst[1]
    s.removed.add(taken.key)
    return True


def _reduce(s: Selection) -> bool:
    """Put a simpler law in the place of one of which a parameter's interval holds zero, else take it off."""
    V, slices = covariance(s.problem, s.solution, s.weights, s.rows)
    for term, c, own in zip(s.solution.terms, s.solution.coefficients, slices, strict=True):
        intervals = law_parameters(term.law, c, term.shape, V[own, own])
        if all(low > 0 or high < 0 for name, (_, low, high, _) in intervals.items() if name not in UNSIGNED):
            continue
        rest = [t for t in s.solution.terms if t != term]
        simpler = [law for law in s.problem.laws[term.joint] if law.id in term.law.holds and not law.form and not law.shape_name]
        trials = [(s.solve([*rest, new]), new) for new in (Term(term.joint, law, 0.0) for law in simpler)]
        sane = [trial for trial, new in trials if trial.sane(new)]
        s.solution = min(sane, key=lambda x: x.sse(term.joint)) if sane else s.solve(rest)
        s.removed.add(term.key)
        return True
    return False
