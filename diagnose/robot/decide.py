"""From the search to an answer: findings with intervals, equivalents, verdict of each joint, and what differs from the file
in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from diagnose.evidence.conditioning import conditioning_of
from diagnose.evidence.held_out import compare
from diagnose.result import Conditioning, Estimate, FitFigures, Verdict
from diagnose.robot.laws import law_parameters
from diagnose.robot.linear import inverse, solved
from diagnose.robot.options import RobotOptions
from diagnose.robot.physical import consistent
from diagnose.robot.problem import JOINT_PARAMETERS, Problem, Term
from diagnose.robot.result import BaseParameter, RobotFinding
from diagnose.robot.solve import Solution, covariance, held_out, normal, solve, told_apart, unpacked
from diagnose.robot.state import Selection, replaced, screen
from diagnose.thresholds import EQUIVALENT
from mjsim.quantity import Motion, Quantity
from mjsim.robot.inertia import NAMES, SIZE

__all__ = [
    "base_parameters",
    "changes",
    "determined",
    "estimates",
    "figures",
    "findings",
    "nominal_solution",
    "posterior",
    "refit",
    "verdict",
]

UNITS = dict(zip(NAMES, ("kg", *["kg m"] * 3, *["kg m^2"] * 6), strict=True))
KINDS = dict(zip(JOINT_PARAMETERS, (Quantity.INERTIA, Quantity.DAMPING, Quantity.TORQUE, Quantity.STIFFNESS), strict=True))
RANK = 0.1  # of the prior: a direction whose posterior standard deviation is below it is determined by the motion


def nominal_solution(problem: Problem, weights: Mapping[int, float]) -> Solution:
    """The file as given: no parameter free, no effect added."""
    n = normal(problem, (), weights, ())
    return unpacked(problem, (), n, np.zeros(len(n.g)))


def figures(problem: Problem, s: Solution, weights: Mapping[int, float], joint: int) -> FitFigures:
    """Errors of a joint's torque [N m | N], and over the spread of the measured one, on fitted and held-out samples."""
    held = held_out(problem, s, weights, joint)
    e = s.fitted[joint]
    spread = float(np.std(problem.fitted[joint].measured)) + 1e-300
    rms = float(np.sqrt(np.mean(e**2)))
    return FitFigures(rms, rms / spread, held.rms, held.nrmse)


def _interval(value: float, error: float, unit: str) -> Estimate:
    return Estimate(value, (value - 1.96 * error, value + 1.96 * error), unit)


def estimates(problem: Problem, s: Solution, V: np.ndarray) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """(links' and joints' own parameters by name) with intervals; those that the prior tells are given at their prior's width."""
    links: dict[str, Estimate] = {}
    own: dict[str, Estimate] = {}
    size = len(problem.robot.links) * SIZE
    for k, name in enumerate(problem.names):
        error = min(math.sqrt(max(V[k, k], 0.0)), float(problem.scale[k]))
        joint, _, kind = name.rpartition(".")
        if k < size:
            links[name] = _interval(float(s.theta[k]), error, UNITS[kind])
        else:
            motion = problem.robot.motions[problem.robot.joints.index(joint)]
            own[name] = _interval(float(s.theta[k]), error, KINDS[kind].unit(motion))
    return links, own


def findings(search: Selection, V: np.ndarray, slices: Sequence[slice]) -> dict[int, list[RobotFinding]]:
    """Findings by joint, each with intervals by the delta method, evidence and equivalents."""
    p, s, robot = search.problem, search.solution, search.problem.robot
    out: dict[int, list[RobotFinding]] = {j: [] for j in p.joints}
    for term, c, own in zip(s.terms, s.coefficients, slices, strict=True):
        without = search.solve([t for t in s.terms if t != term])
        step = search.step(without, s, term.joint)
        motion = robot.motions[term.joint]
        parameters = {
            name: Estimate(value, (low, high), quantity.unit(motion))
            for name, (value, low, high, quantity) in law_parameters(term.law, c, term.shape, V[own, own]).items()
        }
        before, after = (held_out(p, x, search.weights, term.joint) for x in (without, s))
        evidence = {
            "held_out_error_before": before.rms, "held_out_error_after": after.rms,
            "p_value": min(1.0, step.held.p_value * search.multiplicity(term.law)), "delta_chi2": search.raw_gain(without, s),
            "hypotheses": search.multiplicity(term.law),
        }  # fmt: skip
        joint = robot.joints[term.joint]
        out[term.joint].append(
            RobotFinding(
                term.law.id, joint, joint, term.law.sentence, parameters, evidence, _equivalents(search, without, term),
                term.law.form, term.law.source,
            )
        )  # fmt: skip
    return out


def _equivalents(search: Selection, without: Solution, term: Term) -> tuple[str, ...]:
    """Laws that could stand in the place of a term: within `EQUIVALENT` of it on fitted and held-out samples, less the price."""
    s = search.solution
    commons = {law.id for law in search.problem.laws[term.joint] if law.common}
    out = [x for x in term.law.holds if x not in commons] if term.law.is_sum else []  # beside the common one, the same torque
    for _, other in screen(search, without, term.joint)[:6]:
        if other.law.id == term.law.id or any(t.joint == term.joint and t.law.id == other.law.id for t in without.terms):
            continue
        trial = search.solve(replaced(without.terms, other))
        refines = term.law.id in other.law.holds  # a law that contains it and gains nothing is no equivalent
        if trial.sane(other) and not refines and search.step(s, trial, term.joint).total > -EQUIVALENT:
            out.append(other.law.id)
    return tuple(dict.fromkeys(out))


def verdict(
    problem: Problem, options: RobotOptions, weights: Mapping[int, float], joint: int, found: bool, remains: tuple[float, float],
    given: Solution, refitted: Solution,
) -> Verdict:  # fmt: skip
    """Verdict of a joint: structure that a black-box model predicts on held-out samples, else effects, parameters, or nothing."""
    if remains[0] > options.remains:
        return Verdict.UNEXPLAINED
    if found:
        return Verdict.MISSING_PHYSICS
    share = told_apart(problem, given, refitted, joint)
    test = compare(*(held_out(problem, x, weights, joint, share) for x in (given, refitted)))
    if test.relative_gain > options.material and test.p_value < options.p_enter:
        return Verdict.PARAMETERS_ONLY
    return Verdict.NO_MISMATCH


def base_parameters(problem: Problem, s: Solution, V: np.ndarray, most: int = 40) -> tuple[BaseParameter, ...]:
    """Combinations of the robot's own parameters that the motion determines, by QR with column pivoting of the scaled regressor.

    A determined column and the multiples of the others that cannot be told from it are one combination.
    Source: M. Gautier, J. Robotic Systems 8 (1991) 485.
    """
    from scipy.linalg import qr

    _, R, pivot = qr(_regressor(problem), pivoting=True, mode="economic")
    diagonal = np.abs(np.diag(R))
    rank = int(np.sum(diagonal > 1e-6 * diagonal[0]))
    beta = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])
    out = []
    V = V[: len(problem.names), : len(problem.names)]
    for i in range(min(rank, most)):
        k = pivot[i]
        row = np.zeros(len(problem.names))
        row[k] = 1.0
        row[pivot[rank:]] = beta[i] * problem.scale[k] / problem.scale[pivot[rank:]]
        error = math.sqrt(max(float(row @ V @ row), 0.0))
        if error > RANK * problem.scale[k]:
            continue
        others = [(problem.names[m], row[m]) for m in pivot[rank:] if abs(row[m]) * problem.scale[m] > 1e-3 * problem.scale[k]]
        words = problem.names[k] + "".join(f" {'+' if w > 0 else '-'} {abs(w):.4g} {name}" for name, w in others)
        kind = problem.names[k].rpartition(".")[2]
        unit = UNITS.get(kind) or KINDS[kind].unit(Motion.HINGE)
        out.append(BaseParameter(words, _interval(float(row @ s.theta), error, unit), float(row @ problem.nominal)))
    return tuple(out)


def determined(problem: Problem) -> Conditioning:
    """How many of the robot's own parameters the motion tells apart."""
    return conditioning_of(_regressor(problem), problem.names)


def _regressor(problem: Problem) -> np.ndarray:
    """The triangular factor (P, P) of the regressor of all joints, each over the spread of its torque."""
    rows = [problem.grams[j][0] / (float(np.std(problem.fitted[j].measured)) + 1e-300) for j in problem.joints]
    return np.asarray(np.linalg.qr(np.concatenate(rows), mode="r"))


def changes(search: Selection) -> tuple[str, ...]:
    """In words, the fewest groups of the file's own numbers that have to change: links, armatures, dampings.

    Groups enter one after the other, all else as in the file, until none gains more than its price: BIC with one number for a
    joint's own parameter, and for a link as many as the data determine of its ten. Where the values that fit best then are those
    of no body, the values are those of the physical solution, in which all numbers are free.
    """
    p, s = search.problem, search.solution
    size = len(p.robot.links) * SIZE
    groups = {name: np.arange(i * SIZE, (i + 1) * SIZE) for i, name in enumerate(p.robot.link_names)}
    groups |= {name: np.array([k]) for k, name in enumerate(p.names) if k >= size}
    n = normal(p, s.terms, search.weights, s.columns)
    P = len(p.names)
    rest = np.arange(P, len(n.g))
    least = 2.0 * math.log(len(groups))

    def cost(names: Sequence[str]) -> float:
        use = np.concatenate([*(groups[c] for c in names), rest]).astype(int)
        price = sum(search.price * _numbers(n.H, groups[c]) for c in names)
        return price - (float(n.g[use] @ solved(n.H[np.ix_(use, use)], n.g[use])) if len(use) else 0.0)

    chosen: list[str] = []
    for _ in range(2 * len(groups)):
        gains = [(cost(chosen) - cost([*chosen, name]), len(groups[name]) == 1, name) for name in groups if name not in chosen]
        paying = [g for g in gains if g[0] > least]
        if not paying:
            break
        # a joint's own number before a link's ten, of which some turn as it does, unless the link gains much more
        single = max((g for g in paying if g[1]), default=None)
        best = max(paying)
        chosen.append(single[2] if single is not None and single[0] > 0.5 * best[0] else best[2])
        for name in list(chosen[:-1]):
            fewer = [c for c in chosen if c != name]
            if cost(fewer) - cost(chosen) < least:
                chosen = fewer
    use = np.concatenate([*(groups[c] for c in chosen), rest]).astype(int) if chosen else rest
    x = np.zeros(len(n.g))
    x[use] = solved(n.H[np.ix_(use, use)], n.g[use])
    V = np.zeros_like(n.H)
    V[np.ix_(use, use)] = inverse(n.H[np.ix_(use, use)])
    if not consistent(p, p.nominal + p.scale * x[:P]):
        x[:P] = (s.theta - p.nominal) / p.scale
        V[:P, :P] = posterior(search)[0][:P, :P] / np.outer(p.scale, p.scale)
    return tuple(_in_words(p, name, groups[name], x, V) for name in chosen)


def _numbers(H: np.ndarray, own: np.ndarray) -> float:
    """How many of a group's numbers the data determine: the sum of h / (1 + h) over the eigenvalues of their information."""
    h = np.linalg.eigvalsh(H[np.ix_(own, own)] - np.eye(len(own)))
    return float(np.sum(np.maximum(h, 0.0) / (1.0 + np.maximum(h, 0.0))))


def _in_words(p: Problem, name: str, own: np.ndarray, x: np.ndarray, V: np.ndarray) -> str:
    """What changes of a group, with its 95 % interval."""

    def told(k: int, unit: str) -> str:
        value, half = float(p.nominal[k] + x[k] * p.scale[k]), 1.96 * math.sqrt(V[k, k]) * float(p.scale[k])
        low = value - half if k < len(p.robot.links) * SIZE else max(value - half, 0.0)  # a joint's numbers are not negative
        return f"{p.nominal[k]:.4g} -> {value:.4g} {unit} [{low:.4g}, {value + half:.4g}]"

    first = int(own[0])
    if len(own) == 1:
        joint, _, kind = name.rpartition(".")
        return f"{kind} of {joint}: {told(first, KINDS[kind].unit(p.robot.motions[p.robot.joints.index(joint)]))}"
    if 1.96 * math.sqrt(V[first, first]) < abs(x[first]):
        word = "payload or mass" if p.robot.link_names[-1] == name and x[first] > 0 else "mass"
        return f"{word} of {name}: {told(first, 'kg')}"
    sure = np.abs(x[own]) > 1.96 * np.sqrt(np.diag(V)[own])
    most = int(np.argmax(np.where(sure, np.abs(x[own]), 0.0)))
    numbers = told(int(own[most]), UNITS[NAMES[most]])
    return f"inertial parameters of {name}, of which mass and centre are not told apart, most in {NAMES[most]}: {numbers}"


def refit(search: Selection) -> Solution:
    """The refitted nominal robot: its own parameters free, no effect, physically consistent, in the search's weights."""
    return search.physical(solve(search.problem, (), search.weights, search.rows))


def posterior(search: Selection) -> tuple[np.ndarray, list[slice]]:
    """Covariance of the search's solution, and the slice of each term."""
    return covariance(search.problem, search.solution, search.weights, search.rows)
