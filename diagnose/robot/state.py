"""The state of a search: problem, weights, solution so far, and what a move would gain; the screening of all candidates."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from diagnose.evidence.held_out import Comparison, compare
from diagnose.robot.laws import Law, Row
from diagnose.robot.linear import inverse_root, solved
from diagnose.robot.options import RobotOptions
from diagnose.robot.physical import physical
from diagnose.robot.problem import Problem, Term
from diagnose.robot.solve import Solution, held_out, solve, told_apart, worth

__all__ = ["Refusal", "Selection", "Step", "replaced", "screen", "size"]

REWEIGHED = 2  # rounds of weights of a candidate's own row: the second changes them by some per cent


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

        Half of the level is for the commonest effect, dry friction, at any joint; half for all other laws at all joints. The
        weights are
        fixed beforehand, so that the family-wise error stays (C. R. Genovese, K. Roeder, L. Wasserman, Biometrika 93 (2006) 509).
        """
        common = sum(x.common for laws in self.problem.laws.values() for x in laws)
        if common in (0, self.hypotheses):
            return float(self.hypotheses)
        return 2.0 * (common if law.common else self.hypotheses - common)

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
        return self.price * size(terms) + sum(2.0 * math.log(len(t.law.grid)) for t in terms)

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

    def reweighed(self, trial: Solution, joint: int) -> Solution:
        """The trial with the row of a joint in the weight of the trial's own residual.

        In the weight that the poorer structure left, the prior of the robot's own parameters counts for too much beside the
        row: a likelihood is compared at its own maximum over the size of its residual.
        """
        for _ in range(REWEIGHED):
            e = trial.fitted[joint]
            rms = float(np.sqrt(np.mean(e**2))) + 1e-300
            weights = {**self.weights, joint: math.sqrt(worth(self.problem, joint, e, e)) / rms}
            trial = physical(self.problem, solve(self.problem, trial.terms, weights, self.rows, self.cache), weights)
        return trial

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
        """The test that refuses a step; empty when none does. ``more``: numbers that it adds; ``ease``: of the level and the
        sizes."""
        entry = 2.0 * math.log(self.candidates) / ease if more > 0 else 0.0
        if step.gain < entry:
            return f"gains {step.gain:.1f} on the fitted samples, {entry:.1f} needed"
        if step.held.relative_gain < self.options.material / ease:
            taken, needed = 100 * step.held.relative_gain, 100 * self.options.material
            return f"takes {taken:.1f} % off the held-out squared error of its joint, {needed:g} % needed"
        p = min(1.0, step.held.p_value * self.multiplicity(law))
        if p > self.options.p_enter * ease:
            return f"held-out p = {p:.2g} over all joints and laws, {self.options.p_enter:g} needed"
        return ""


def size(terms: Sequence[Term]) -> int:
    """Free numbers of the terms."""
    return sum(_numbers(t.law) for t in terms)


@functools.lru_cache(maxsize=4096)
def _numbers(law: Law) -> int:
    x = np.linspace(0.1, 1.0, 4)
    row = Row(x, x, x, x, x, x, {law.source: (x, x)} if law.source else {})
    return len(law.columns(row, law.grid[0])) + (1 if law.shape_name else 0)


def replaced(terms: Sequence[Term], new: Term) -> tuple[Term, ...]:
    """Terms with a new one, in place of those of its joint that it contains, or that contain it."""
    kept = [
        t for t in terms
        if not (t.joint == new.joint and (t.law.id in new.law.holds or new.law.id in t.law.holds or t.law.id == new.law.id))
    ]  # fmt: skip
    return (*kept, new)


def screen(s: Selection, now: Solution, joint: int) -> list[tuple[float, Term]]:
    """Best shape of each law at a joint, with the gain that it promises beside a solution, most first.

    The gain is twice the log-likelihood of this row by its independent samples, less the price; a law of many shapes pays for the
    choice, 2 log(number of shapes).
    """
    p = s.problem
    part, e = p.fitted[joint], now.fitted[joint]
    own = [i for i, t in enumerate(now.terms) if t.joint == joint]
    w = s.weights[joint]
    A = np.hstack([part.A * p.scale, *(now.columns[i][0] for i in own)])
    Q = inverse_root(_hessian(s, now, joint, A)).T @ (w * A.T)
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
            c = solved(C.T @ C - QC.T @ QC + 1e-9 * np.eye(C.shape[1]), C.T @ (w * e))
            promised = float((C.T @ (w * e)) @ c)
            if best is None or promised > best[0]:
                best = promised, shape, (C @ c - Q.T @ (QC @ c)) / w
        assert best is not None
        n = len(e) * worth(p, joint, best[2], e - best[2])
        gain = -n * math.log(max(1.0 - best[0] / left, 1e-12))
        term = Term(joint, law, best[1])
        out.append((gain - s.charge(replaced(now.terms, term)) + s.charge(now.terms), term))
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
    return H
