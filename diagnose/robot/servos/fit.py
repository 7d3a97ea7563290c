"""Least squares of one joint's free run: Levenberg-Marquardt on scaled numbers, the samples weighted by block.

Positive numbers are fitted as their logarithm. Differences are wide (1 % of a number), since a run that sticks and slips is
rough at
small scale. Source: J. Nocedal, S. J. Wright, Numerical Optimization (2006), ch. 10.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.evidence.conditioning import conditioning_of
from diagnose.result import Conditioning
from diagnose.robot.linear import inverse, solved
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.solve import autocorrelation
from mjsim.robot.joint_kernel import SLOT

__all__ = [
    "BLOCK",
    "Fit",
    "Number",
    "block_loss",
    "block_scale",
    "block_squares",
    "block_weights",
    "counted",
    "covariance",
    "determined",
    "fit",
    "independent",
    "jacobian",
    "prior_errors",
    "slots_of",
    "start_of",
]

WIDE = 0.01  # step of the differences, of a number's scale
MOST = 25  # iterations
ENDS = 1e-4  # relative decrease of the sum of squares below which an iteration is the last
LONGEST = 1.5  # step of a coded number in one iteration
MEMORY = 2.0  # [s] over which errors may be correlated
BLOCK = 4.0  # [s] that are one independent block of a covariance
BOUND = 12.0  # of a logarithm: a factor of 1.6e5 from the start of a fit


@dataclass(frozen=True)
class Number:
    """One free number: slot that it fills; log: fitted as its logarithm; scale of one that is not [its unit]; lower, upper
    bounds.

    prior: coded value and its standard deviation, None for a flat one.
    """

    slot: str
    log: bool = True
    scale: float = 1.0
    lower: float = -math.inf
    upper: float = math.inf
    prior: tuple[float, float] | None = None

    def coded(self, value: float) -> float:
        """Fitted form of a value."""
        return math.log(max(value, 1e-300)) if self.log else value / self.scale

    def value(self, x: float) -> float:
        """Value of a fitted form, within the bounds."""
        raw = math.exp(min(max(x, -690.0), 690.0)) if self.log else x * self.scale
        return min(max(raw, self.lower), self.upper)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted structure: numbers, their coded values x (P,), slots (K,), error (N,) [rad | m] and weighted sum of squares.

    weights (N,): of the samples' errors [1/rad | 1/m], see `block_weights`; sse has the prior's part in it.
    """

    numbers: tuple[Number, ...]
    x: np.ndarray
    slots: np.ndarray
    error: np.ndarray
    sse: float
    weights: np.ndarray

    def rms(self, mask: np.ndarray) -> float:
        """Root mean square error over some samples; nan where there are none."""
        return float(np.sqrt(np.mean(self.error[mask] ** 2))) if mask.any() else math.nan


def slots_of(problem: JointProblem, numbers: Sequence[Number], x: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Slots (K,) with these numbers in the place of those of ``base``.

    "damp" is the sum of kv and the joint's damping, which act alike: the joint keeps what the file gives it as long as the sum
    allows.
    """
    p = base.copy()
    for number, value in zip(numbers, x, strict=True):
        amount = number.value(float(value))
        if number.slot == "load_both":
            p[SLOT["load"]] = p[SLOT["load_back"]] = amount
        elif number.slot == "damp":
            own = min(float(problem.nominal[SLOT["damping"]]), amount)
            p[SLOT["damping"]], p[SLOT["kv"]] = own, amount - own
        else:
            p[SLOT[number.slot]] = amount
    return p


def start_of(numbers: Sequence[Number], p: np.ndarray) -> np.ndarray:
    """Coded values (P,) of these numbers in slots."""
    return np.array([n.coded(_slot(p, n.slot)) for n in numbers])


def _slot(p: np.ndarray, name: str) -> float:
    if name == "damp":
        return float(p[SLOT["kv"]] + p[SLOT["damping"]])
    return float(p[SLOT["load" if name == "load_both" else name]])


def independent(e: np.ndarray, dt: float, difference: np.ndarray | None = None) -> float:
    """Share of samples (n,) of an error that are worth an independent one, 1 / (1 + 2 sum rho_k sigma_k).

    rho: autocorrelation of the error, sigma: of the difference of two predictions, or of the error itself.
    Source: M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536.
    """
    if len(e) < 8 or not np.any(e):
        return 1.0
    lags = min(round(MEMORY / dt), len(e) // 4)
    rho = autocorrelation(e, lags)[1:]
    sigma = rho if difference is None else autocorrelation(difference, lags)[1:]
    return 1.0 / max(1.0, 1.0 + 2.0 * float(rho @ sigma))


def block_squares(problem: JointProblem, error: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean square of errors (N,) over the samples of a mask in each block of `BLOCK`, and the number of these samples."""
    block = problem.blocks(BLOCK)
    size = int(block[-1]) + 1
    count = np.bincount(block[mask], minlength=size)
    return np.bincount(block[mask], error[mask] ** 2, minlength=size) / np.maximum(count, 1), count


def block_scale(problem: JointProblem, error: np.ndarray) -> float:
    """Scale s^2 of errors (N,): median of the mean squares of the fitted blocks, at least the squared noise."""
    squares, count = block_squares(problem, error, problem.fitted)
    return max(float(np.median(squares[count > 0])) if count.any() else 0.0, problem.noise**2, 1e-24)


def block_loss(problem: JointProblem, error: np.ndarray, scale: float) -> float:
    """Loss sum_b n_b log(s^2 + m_b) of errors (N,) over the fitted blocks, with s^2 = ``scale``."""
    squares, count = block_squares(problem, error, problem.fitted)
    return float(count @ np.log(scale + squares))


def block_weights(problem: JointProblem, error: np.ndarray) -> np.ndarray:
    """Weights (N,) [1/rad | 1/m] of the samples: sqrt(share of independent samples) / sqrt(s^2 + m_b) by errors (N,).

    m_b: mean square of the error in the sample's block, s^2: `block_scale`. The weights are those of iteratively reweighted
    least squares for `block_loss`: the error of a model differs from block to block, and one that no model follows (contact,
    a stop) has a bounded influence. Fitted and held-out samples of a block are weighted apart.
    Source: P. J. Rousseeuw, A. M. Leroy, Robust Regression and Outlier Detection (1987), ch. 1.
    """
    block, own = problem.blocks(BLOCK), np.zeros(len(error))
    for mask in (problem.fitted, problem.held):
        own[mask] = block_squares(problem, error, mask)[0][block[mask]]
    return np.asarray(math.sqrt(_independent_share(problem, error)) / np.sqrt(block_scale(problem, error) + own))


def _independent_share(problem: JointProblem, error: np.ndarray) -> float:
    """Mean share of independent samples over the recordings, of the fitted samples."""
    runs = range(len(problem.starts) - 1)
    own = [e for k in runs if len(e := error[problem.part(k)][problem.fitted[problem.part(k)]])]
    return float(np.average([independent(e, problem.dt) for e in own], weights=[len(e) for e in own]))


def _weighted(problem: JointProblem, error: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted errors of the fitted samples."""
    return np.asarray((weights * error)[problem.fitted])


def prior_errors(numbers: Sequence[Number], x: np.ndarray) -> np.ndarray:
    """Errors of coded numbers (P,) from their priors, over the standard deviations, of those that have one."""
    return np.array([(v - n.prior[0]) / n.prior[1] for n, v in zip(numbers, x, strict=True) if n.prior is not None])


def jacobian(
    problem: JointProblem, numbers: Sequence[Number], x: np.ndarray, base: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Derivatives (n + priors, P) of the weighted errors of the fitted samples, by wide central differences, then of the
    priors."""
    J = np.empty((int(problem.fitted.sum()), len(numbers)))
    for k in range(len(numbers)):
        ends = []
        for s in (WIDE, -WIDE):
            moved = x.copy()
            moved[k] += s
            ends.append(_weighted(problem, problem.error(slots_of(problem, numbers, moved, base)), weights))
        J[:, k] = (ends[0] - ends[1]) / (2 * WIDE)
    own = [k for k, n in enumerate(numbers) if n.prior is not None]
    P = np.zeros((len(own), len(numbers)))
    for i, k in enumerate(own):
        prior = numbers[k].prior
        assert prior is not None
        P[i, k] = 1.0 / prior[1]
    return np.vstack([J, P])


def fit(
    problem: JointProblem,
    numbers: Sequence[Number],
    base: np.ndarray,
    weights: np.ndarray,
    most: int = MOST,
    part: JointProblem | None = None,
) -> Fit:
    """The least-squares numbers from their values in ``base`` (K,), which holds all that is not free.

    part: samples that are fitted, all of the fitted ones by default; `Fit.error` is of all samples, its ``sse`` of the part.
    """
    part = part or problem.with_fitted()
    own = weights[part.rows]
    center = start_of(numbers, base)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.concatenate([_weighted(part, part.error(slots_of(part, numbers, x, base)), own), prior_errors(numbers, x)])

    x, r = center.copy(), residual(center)
    best, damping = float(r @ r), 1e-2
    for _ in range(most if numbers else 0):
        J = jacobian(part, numbers, x, base, own)
        H, g, before = J.T @ J, J.T @ r, best
        for _ in range(6):
            step = -solved(H + damping * np.diag(np.diag(H) + 1e-9 * np.trace(H) + 1e-30), g)
            trial = _within(numbers, x + np.clip(step, -LONGEST, LONGEST), center)
            new = residual(trial)
            if float(new @ new) < best:
                x, r, best, damping = trial, new, float(new @ new), max(damping / 5, 1e-7)
                break
            damping *= 5
        if before - best < ENDS * before:
            break
    p = slots_of(problem, numbers, x, base)
    return Fit(tuple(numbers), x, p, problem.error(p), best, weights)


def _within(numbers: Sequence[Number], x: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Coded values within the bounds of each number, logarithms within `BOUND` of the start."""
    logs = np.array([n.log for n in numbers])
    x = np.where(logs, np.clip(x, center - BOUND, center + BOUND), x)
    return np.array([n.coded(n.value(float(v))) for n, v in zip(numbers, x, strict=True)])


def counted(problem: JointProblem, found: Fit, weights: np.ndarray) -> Fit:
    """The fit counted in other weights, its numbers kept."""
    r = np.concatenate([_weighted(problem, found.error, weights), prior_errors(found.numbers, found.x)])
    return dataclasses.replace(found, weights=weights, sse=float(r @ r))


def determined(problem: JointProblem, found: Fit) -> Conditioning:
    """How many of the fitted numbers the data of the joint tell apart."""
    part = problem.with_fitted()
    J = jacobian(part, found.numbers, found.x, found.slots, found.weights[part.rows])
    return conditioning_of(J[: int(part.fitted.sum())], [n.slot for n in found.numbers])


def covariance(problem: JointProblem, found: Fit) -> np.ndarray:
    """Covariance (P, P) of the coded numbers, cluster-robust over blocks of `BLOCK`, prior included; at least that of the
    weights.

    The uncertainty of the masses that the joint carries is added: H^-1 J' C V C' J H^-1, with C the derivative of the errors by
    the masses and V their covariance.

    Source: K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13.
    """
    part = problem.with_fitted()
    own = found.weights[part.rows]
    J = jacobian(part, found.numbers, found.x, found.slots, own)
    n = int(part.fitted.sum())
    r = _weighted(part, found.error[part.rows], own)
    H = J.T @ J
    H += np.diag(1e-9 * np.diag(H) + 1e-12)
    _, where = np.unique(part.blocks(BLOCK)[part.fitted], return_inverse=True)
    scores = np.zeros((int(where.max()) + 1, len(found.x)))
    np.add.at(scores, where, J[:n] * r[:, None])
    few = len(scores) / max(len(scores) - len(found.x), 1)
    prior = J[n:].T @ J[n:]
    inverted = inverse(H)
    robust = inverted @ (few * scores.T @ scores + prior) @ inverted
    least = np.diag(inverted)
    larger = np.sqrt(np.maximum(least / np.maximum(np.diag(robust), 1e-12 * least), 1.0))
    G = inverted @ J[:n].T @ _by_masses(part, found, own)
    return np.asarray(robust * np.outer(larger, larger) + G @ part.masses_variance @ G.T)


def _by_masses(part: JointProblem, found: Fit, weights: np.ndarray) -> np.ndarray:
    """Derivatives (n, C) of the weighted errors by the masses; zero for those without a variance."""
    out = np.zeros((int(part.fitted.sum()), len(part.masses)))
    for k in np.flatnonzero(np.diag(part.masses_variance) > 0.0):
        step = np.zeros(len(part.masses))
        step[k] = math.sqrt(part.masses_variance[k, k])
        ends = [_weighted(part, part.with_masses(part.masses + s * step).error(found.slots), weights) for s in (1.0, -1.0)]
        out[:, k] = (ends[0] - ends[1]) / (2.0 * step[k])
    return out
