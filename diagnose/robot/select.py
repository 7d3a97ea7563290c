"""Which effects, at which joints: forward selection over the whole robot, exchange and removal, each step held to unseen data.

Candidates are (joint, law, shape). Their gain is screened at once, by projection on what the fitted columns do not span; the few best
laws are refitted with everything else free. One enters when it pays on the fitted samples (extended BIC, J. Chen, Z. Chen,
Biometrika 95 (2008) 759), is physical, and predicts held-out samples better: paired block tests whose p-value, times the number of
(joint, law) hypotheses, is below the level.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from diagnose.evidence.held_out import Comparison, compare
from diagnose.robot.laws import Law, Row, law_parameters
from diagnose.robot.options import RobotOptions
from diagnose.robot.physical import physical
from diagnose.robot.problem import Problem, Term
from diagnose.robot.solve import Solution, covariance, held_out, solve, told_apart, weigh, worth

__all__ = ["Refusal", "Selection", "Step", "select"]

COMMON = "coulomb_friction"
FINALISTS = 5  # laws of a joint that are refitted, by what the screening promises
PROMISING = 0.5  # of what is needed to enter: a promise is the gain of one row alone
ROUNDS = 40  # moves at most: each lowers the criterion, so that it ends by itself
UNSIGNED = ("phase_rad", *(f"coefficient_{k}" for k in range(5)))  # nought is a value like any other
NOT_PHYSICAL = "its coefficients are not physical"
STAYS = 5.0  # times the level to enter, at which a term stays: what enters at 1 % may stay at 5 %
ALIKE = 10.0  # twice a log-likelihood ratio within which two laws are not told apart (a likelihood ratio of 150)


@dataclass(frozen=True)
class Step:
    """What a move gains: twice the log-likelihood less the price, and the held-out test of the joint that it is about.

    likelihood: twice the log-likelihood on the held-out samples of that joint.
    """

    gain: float
    held: Comparison
    likelihood: float = 0.0

    @property
    def total(self) -> float:
        """What is gained on fitted and held-out samples together, less the price."""
        return self.gain + self.likelihood


@dataclass(frozen=True)
class Refusal:
    """A law that screened well and was refused: where, which test, by which numbers."""

    joint: int
    law: Law
    reason: str
    step: Step


@dataclass(eq=False)
class Selection:
    """The search: its problem, options, rows with the load as refitted, weights, and the solution so far."""

    problem: Problem
    options: RobotOptions
    rows: list[dict[int, Row]]
    weights: dict[int, float]
    solution: Solution
    refusals: dict[tuple[int, str], Refusal] = field(default_factory=dict)
    cache: dict[Term, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    removed: set[tuple[int, str]] = field(default_factory=set)
    visited: set[frozenset[tuple[int, str]]] = field(default_factory=set)

    @functools.cached_property
    def hypotheses(self) -> int:
        """Number of (joint, law) that the held-out data may be asked about."""
        return sum(len(laws) for laws in self.problem.laws.values())

    def multiplicity(self, law: Law) -> float:
        """What a p-value of a law is multiplied by: weighted Bonferroni over all joints and laws.

        Half of the level is for the commonest effect, dry friction, at any joint; half for all other laws at all joints. The weights are
        fixed beforehand, so that the family-wise error stays (C. R. Genovese, K. Roeder, L. Wasserman, Biometrika 93 (2006) 509).
        """
        common = sum(x.id == COMMON for laws in self.problem.laws.values() for x in laws)
        if common in (0, self.hypotheses):
            return float(self.hypotheses)
        return 2.0 * (common if law.id == COMMON else self.hypotheses - common)

    @functools.cached_property
    def candidates(self) -> int:
        """Number of (joint, law, shape)."""
        return sum(len(law.grid) for laws in self.problem.laws.values() for law in laws)

    @functools.cached_property
    def price(self) -> float:
        """Of a parameter: log of the number of independent samples (BIC), by the residual of the robot without effects."""
        s = self.solution
        n = sum(len(s.fitted[j]) * worth(self.problem, j, s.fitted[j], s.fitted[j]) for j in self.problem.joints)
        return math.log(max(n, 3.0))

    def known(self, solution: Solution) -> bool:
        """Whether the search stood at these laws before."""
        return frozenset(t.key for t in solution.terms) in self.visited

    def charge(self, terms: Sequence[Term]) -> float:
        """What the numbers of the terms cost, and the choice among the shapes of a grid: 2 log of their number."""
        return self.price * _size(terms) + sum(2.0 * math.log(len(t.law.grid)) for t in terms)

    def columns(self, term: Term) -> tuple[np.ndarray, np.ndarray]:
        """Columns of a term, kept."""
        if term not in self.cache:
            self.cache[term] = self.problem.columns(term, self.rows)
        return self.cache[term]

    def fill(self, terms: Sequence[Term]) -> None:
        """Compute what is not kept, together."""
        self.cache |= self.problem.all_columns([t for t in terms if t not in self.cache], self.rows)

    def solve(self, terms: Sequence[Term]) -> Solution:
        """The physically consistent solution with other terms."""
        self.fill(terms)
        return self.physical(solve(self.problem, terms, self.weights, self.rows, self.cache))

    def physical(self, solution: Solution) -> Solution:
        """The physically consistent solution of the same terms."""
        return physical(self.problem, solution, self.weights)

    def raw_gain(self, poorer: Solution, richer: Solution) -> float:
        """Twice the log of the likelihood ratio, each row by its independent samples."""
        total = 0.0
        for j in self.problem.joints:
            a, b = poorer.fitted[j], richer.fitted[j]
            if np.array_equal(a, b):
                continue
            share = worth(self.problem, j, a - b, b)
            total += share * len(b) * math.log((a @ a + 1e-300) / (b @ b + 1e-300))
        return total

    def step(self, poorer: Solution, richer: Solution, joint: int) -> Step:
        """What the richer solution gains over the poorer one."""
        more = self.charge(richer.terms) - self.charge(poorer.terms)
        share = told_apart(self.problem, poorer, richer, joint)
        before, after = (held_out(self.problem, x, self.weights, joint, share) for x in (poorer, richer))
        return Step(self.raw_gain(poorer, richer) - more, compare(before, after), self.held_gain(poorer, richer, joint))

    def held_gain(self, poorer: Solution, richer: Solution, joint: int) -> float:
        """Twice the log of the likelihood ratio on the held-out samples of a joint, by its independent samples."""
        a, b = poorer.held[joint], richer.held[joint]
        return told_apart(self.problem, poorer, richer, joint) * len(b) * math.log((a @ a + 1e-300) / (b @ b + 1e-300))

    def why_not(self, step: Step, law: Law, more: int, ease: float = 1.0) -> str:
        """The test that refuses a step; empty when none does. ``more``: numbers that it adds; ``ease``: of the level and the sizes."""
        entry = 2.0 * math.log(self.candidates) / ease if more > 0 else 0.0
        if step.gain < entry:
            return f"gains {step.gain:.1f} on the fitted samples, {entry:.1f} needed"
        if step.held.relative_gain < self.options.material / ease:
            return f"takes {100 * step.held.relative_gain:.1f} % off the held-out squared error of its joint, {100 * self.options.material:g} % needed"
        p = min(1.0, step.held.p_value * self.multiplicity(law))
        if p > self.options.p_enter * ease:
            return f"held-out p = {p:.2g} over all joints and laws, {self.options.p_enter:g} needed"
        return ""


def _size(terms: Sequence[Term]) -> int:
    """Free numbers of the terms."""
    return sum(_numbers(t.law) for t in terms)


@functools.lru_cache(maxsize=4096)
def _numbers(law: Law) -> int:
    x = np.linspace(0.1, 1.0, 4)
    row = Row(x, x, x, x, x, x, {law.source: (x, x)} if law.source else {})
    return len(law.columns(row, law.grid[0])) + (1 if law.shape_name else 0)


def select(problem: Problem, options: RobotOptions) -> Selection:
    """Search for the effects. The selection's solution is the last one; its terms are what was found."""
    rows = problem.rows(problem.nominal)
    weights, solution = weigh(problem, (), rows)
    solution = physical(problem, solution, weights)
    found = Selection(problem, options, problem.rows(solution.theta), weights, solution)
    for _ in range(ROUNDS):
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


def _with(terms: Sequence[Term], new: Term) -> tuple[Term, ...]:
    """Terms with a new one, in place of those of its joint that it contains, or that contain it."""
    kept = [
        t for t in terms
        if not (t.joint == new.joint and (t.law.id in new.law.holds or new.law.id in t.law.holds or t.law.id == new.law.id))
    ]  # fmt: skip
    return (*kept, new)


def _screen(s: Selection, now: Solution, joint: int) -> list[tuple[float, Term]]:
    """Best shape of each law at a joint, with the gain that it promises beside a solution, most first.

    The gain is twice the log-likelihood of this row by its independent samples, less the price; a law of many shapes pays for the
    choice, 2 log(number of shapes).
    """
    p = s.problem
    part, e = p.fitted[joint], now.fitted[joint]
    own = [i for i, t in enumerate(now.terms) if t.joint == joint]
    w = s.weights[joint]
    A = np.hstack([part.A * p.scale, *(now.columns[i][0] for i in own)])
    root = np.linalg.cholesky(_hessian(s, now, joint, A))
    Q = np.linalg.solve(root, w * A.T)
    left = w * w * float(e @ e)
    present = {t.law.key for t in now.terms if t.joint == joint}
    s.fill([Term(joint, law, shape) for law in p.laws[joint] for shape in law.grid])
    out = []
    for law in p.laws[joint]:
        if law.key in present:
            continue
        best: tuple[float, float, np.ndarray] | None = None
        for shape in law.grid:
            C = w * s.columns(Term(joint, law, shape))[0]
            C = C / (np.sqrt(np.sum(C**2, axis=0)) + 1e-300)
            QC = Q @ C
            c = np.linalg.solve(C.T @ C - QC.T @ QC + 1e-9 * np.eye(C.shape[1]), C.T @ (w * e))
            promised = float((C.T @ (w * e)) @ c)
            if best is None or promised > best[0]:
                best = promised, shape, (C @ c - Q.T @ (QC @ c)) / w
        assert best is not None
        n = len(e) * worth(p, joint, best[2], e - best[2])
        gain = -n * math.log(max(1.0 - best[0] / left, 1e-12))
        term = Term(joint, law, best[1])
        out.append((gain - s.charge(_with(now.terms, term)) + s.charge(now.terms), term))
    return sorted(out, key=lambda x: -x[0])


def _hessian(s: Selection, now: Solution, joint: int, A: np.ndarray) -> np.ndarray:
    """Hessian of the robot's parameters and of the coefficients at one joint; those of other joints are taken as known."""
    p, P = s.problem, len(s.problem.names)
    H = np.zeros((A.shape[1], A.shape[1]))
    H[np.arange(P), np.arange(P)] = 1.0
    if now.stiffness is not None:
        H[:P, :P] += now.stiffness
    for j in p.joints:
        if j == joint:
            H += s.weights[j] ** 2 * (A.T @ A)
        else:
            H[:P, :P] += s.weights[j] ** 2 * p.grams[j][1]
    return H + 1e-11 * np.diag(np.diag(H))


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
        if len(s.solution.terms) >= s.options.most:
            break
        ranked = [
            x
            for x in _screen(s, s.solution, joint)
            if (not simple or _eligible(s, joint, x[1].law)) and x[1].key not in s.removed
        ]
        best: tuple[float, Solution, Term] | None = None
        for promised, term in ranked[:FINALISTS]:
            if promised < PROMISING * entry:
                break
            trial = s.solve(_with(s.solution.terms, term))
            if s.known(trial):
                continue
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
    """Dry friction and an offset at one joint as one asymmetric friction, the same torque, where the offset is the smaller one."""
    own = {t.law.id: t for t in now.terms if t.joint == joint}
    law = next((x for x in s.problem.laws[joint] if x.id == "asymmetric_friction"), None)
    if law is None or not {"coulomb_friction", "torque_offset"} <= set(own):
        return now
    new = Term(joint, law, law.grid[0])
    merged = s.solve(_with(now.terms, new))
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
        for _, other in _screen(s, rest, term.joint)[:FINALISTS]:
            if other.law.key == term.law.key or any(t.joint == term.joint and t.law.id == other.law.id for t in rest.terms):
                continue
            trial = s.solve(_with(rest.terms, other))
            if s.step(s.solution, trial, term.joint).total > -2 * ALIKE:
                trial = _refined(s, trial, other)
            if trial.sane(other) and not s.known(trial) and _better(s, trial, other):
                s.solution = trial
                return True
    return False


def _better(s: Selection, trial: Solution, new: Term) -> bool:
    """Whether another law at a joint is to take the place of the present one.

    With fewer numbers it must not lose, on fitted and held-out samples together and less the price; with as many it must be clearly
    ahead, and on either; with more it must pass what an effect must pass to enter.
    """
    more = _size(trial.terms) - _size(s.solution.terms)
    step = s.step(s.solution, trial, new.joint)
    if more < 0:
        return step.total > 0.0
    if more == 0:
        return step.total > ALIKE and min(s.raw_gain(s.solution, trial), step.likelihood) > 0.0
    return step.total > ALIKE and not s.why_not(step, new.law, more)


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
    """Put a simpler law in the place of one of which a parameter's interval holds nought, else take it off."""
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
