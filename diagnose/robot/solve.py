"""Solving the regression: weighted least squares with a prior at the nominal robot, intervals for coloured residuals.

Parameters are scaled to x = (theta - nominal) / scale, so that the prior is |x|^2 and the normal equations are never worse
than their
data. Rows are weighted by the rms of their own residual (iteratively reweighted), times the share of independent samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.fit.fitted import HeldOut
from diagnose.robot.laws import Row
from diagnose.robot.linear import inverse, solved
from diagnose.robot.problem import Problem, Term

__all__ = ["Solution", "autocorrelation", "covariance", "held_out", "normal", "solve", "told_apart", "unpacked", "weigh", "worth"]

LAGS = 2.0  # [s] over which residuals may be correlated
BAND = (0.5, 0.99)
RIDGE = 1e-10  # of an effect's coefficient, whose column has unit rms: for columns that depend on each other


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved regression: theta (P,), coefficients of each term, residuals by joint on fitted and held-out samples.

    columns: of each term, fitted and held out; stiffness (P, P): curvature of the barrier that keeps scaled theta physical.
    """

    terms: tuple[Term, ...]
    theta: np.ndarray
    coefficients: tuple[np.ndarray, ...]
    fitted: Mapping[int, np.ndarray]
    held: Mapping[int, np.ndarray]
    columns: tuple[tuple[np.ndarray, np.ndarray], ...]
    stiffness: np.ndarray | None = None

    def sse(self, joint: int) -> float:
        """Sum of squared residuals on the fitted samples of a joint."""
        return float(self.fitted[joint] @ self.fitted[joint])

    def sane(self, term: Term) -> bool:
        """Whether a term, found by its joint and law, has physical coefficients."""
        return all(t.law.sane(c, t.shape) for t, c in zip(self.terms, self.coefficients, strict=True) if t.key == term.key)


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations H x = g in scaled parameters and scaled coefficients: the first P are the robot's own.

    free (P,): which of these are free; fixed (P,): the values of the others; starts: first coefficient of each term; norms:
    rms of
    the columns of each term, by which its coefficients are scaled; columns: of each term.
    """

    H: np.ndarray
    g: np.ndarray
    free: np.ndarray
    fixed: np.ndarray
    starts: np.ndarray
    norms: list[np.ndarray]
    columns: tuple[tuple[np.ndarray, np.ndarray], ...]


def normal(
    problem: Problem, terms: Sequence[Term], weights: Mapping[int, float], columns: tuple[tuple[np.ndarray, np.ndarray], ...]
) -> Normal:
    """The normal equations of these terms. The file's own dry friction gives way to a law of dry friction at its joint."""
    P, sizes = len(problem.names), [c[0].shape[1] for c in columns]
    free, fixed = np.ones(P, bool), np.zeros(P)
    for k in _given_way(problem, terms):
        free[k], fixed[k] = False, -problem.nominal[k] / problem.scale[k]
    starts = P + np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    norms = [np.sqrt(np.mean(c[0] ** 2, axis=0)) + 1e-300 for c in columns]
    K = int(starts[-1])
    H, g = np.zeros((K, K)), np.zeros(K)
    H[np.arange(P), np.arange(P)] = 1.0
    H[np.arange(P, K), np.arange(P, K)] = RIDGE
    for j in problem.joints:
        own = [i for i, t in enumerate(terms) if t.joint == j]
        B, G, b = problem.grams[j]
        w2 = weights[j] ** 2
        H[:P, :P] += w2 * G
        g[:P] += w2 * b
        if own:
            C = np.hstack([columns[i][0] / norms[i] for i in own])
            index = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in own])
            cross = w2 * (B.T @ C)
            H[:P, index] += cross
            H[index, :P] += cross.T
            H[np.ix_(index, index)] += w2 * (C.T @ C)
            g[index] += w2 * (C.T @ problem.fitted[j].y)
    return Normal(H, g, free, fixed, starts, norms, columns)


def _given_way(problem: Problem, terms: Sequence[Term]) -> list[int]:
    """Indices of the file's own dry friction at joints that have a law of dry friction among the terms."""
    return [problem.own_friction[t.joint] for t in terms if t.joint in problem.own_friction and t.law.dry]


def solve(
    problem: Problem, terms: Sequence[Term], weights: Mapping[int, float], rows: Sequence[dict[int, Row]],
    known: Mapping[Term, tuple[np.ndarray, np.ndarray]] | None = None,
) -> Solution:  # fmt: skip
    """The weighted least-squares solution with these terms, whether or not it is physical.

    weights: of a row's residual, by joint; known: columns that are computed already.
    """
    n = normal(problem, terms, weights, tuple(known[t] if known and t in known else problem.columns(t, rows) for t in terms))
    x = np.zeros(len(n.g))
    x[: len(n.fixed)] = n.fixed
    use = np.concatenate([n.free, np.ones(len(x) - len(n.fixed), bool)])
    x[use] = solved(n.H[np.ix_(use, use)], (n.g - n.H @ x)[use])
    return unpacked(problem, terms, n, x)


def unpacked(problem: Problem, terms: Sequence[Term], n: Normal, x: np.ndarray, stiffness: np.ndarray | None = None) -> Solution:
    """The solution of scaled parameters and coefficients x."""
    P = len(problem.names)
    coefficients = tuple(x[n.starts[i] : n.starts[i + 1]] / n.norms[i] for i in range(len(terms)))
    residuals: list[dict[int, np.ndarray]] = []
    for parts, which in ((problem.fitted, 0), (problem.held, 1)):
        left = {}
        for j in problem.joints:
            predicted = parts[j].A @ (x[:P] * problem.scale)
            for i, t in enumerate(terms):
                if t.joint == j:
                    predicted = predicted + n.columns[i][which] @ coefficients[i]
            left[j] = parts[j].y - predicted
        residuals.append(left)
    theta = problem.nominal + problem.scale * x[:P]
    return Solution(tuple(terms), theta, coefficients, residuals[0], residuals[1], n.columns, stiffness)


def weigh(
    problem: Problem, terms: Sequence[Term], rows: Sequence[dict[int, Row]], rounds: int = 4
) -> tuple[dict[int, float], Solution]:
    """Weights of the rows from their own residuals, and the solution: sqrt(share of independent samples) / rms."""
    weights = {j: 1.0 / (float(np.std(problem.fitted[j].measured)) + 1e-300) for j in problem.joints}
    known = {t: problem.columns(t, rows) for t in terms}
    solution = solve(problem, terms, weights, rows, known)
    for _ in range(rounds):
        for j in problem.joints:
            e = solution.fitted[j]
            weights[j] = math.sqrt(worth(problem, j, e, e)) / (float(np.sqrt(np.mean(e**2))) + 1e-300)
        solution = solve(problem, terms, weights, rows, known)
    return weights, solution


def _spread(problem: Problem, joint: int, values: np.ndarray) -> np.ndarray:
    """Values (n, ...) of the fitted samples on the whole time axis, zero where none is fitted."""
    at = problem.fitted[joint].at
    out = np.zeros((int(at[-1]) + 1, *values.shape[1:]))
    out[at] = values
    return out


def autocorrelation(e: np.ndarray, lags: int) -> np.ndarray:
    """Autocorrelation (lags + 1,) of a series (n,), by the Fourier transform; the first is 1, or all zero."""
    n = len(e)
    size = 1 << (2 * n - 1).bit_length()
    r = np.fft.irfft(np.abs(np.fft.rfft(e, size)) ** 2, size)[: lags + 1]
    return np.asarray(r / r[0]) if r[0] > 0 else np.zeros(lags + 1)


def worth(problem: Problem, joint: int, difference: np.ndarray, left: np.ndarray) -> float:
    """Share of a row's samples that are worth an independent one, 1 / (1 + 2 sum rho_k sigma_k).

    rho: autocorrelation of the residual ``left`` (n,), sigma: of the ``difference`` (n,) of two predictions.
    Source: M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536.
    """
    a, b = _spread(problem, joint, left), _spread(problem, joint, difference)
    lags = min(round(LAGS / problem.dt), len(a) // 4)
    total = float(autocorrelation(a, lags)[1:] @ autocorrelation(b, lags)[1:])
    return 1.0 / max(1.0, 1.0 + 2.0 * total)


def told_apart(problem: Problem, poorer: Solution, richer: Solution, joint: int) -> float:
    """Share of independent samples, by `worth`, to tell two solutions apart at a joint."""
    return worth(problem, joint, poorer.fitted[joint] - richer.fitted[joint], richer.fitted[joint])


def held_out(
    problem: Problem, s: Solution, weights: Mapping[int, float], joint: int | None = None, share: float | None = None
) -> HeldOut:
    """Held-out errors over the rms of each row's residual, in blocks three times as long as it remembers.

    share: of independent samples, by default that of each row's own residual; of two solutions that are compared, that of
    `worth`.
    """
    errors, sse, count, squares, spread = [], [], [], 0.0, 0.0
    for j in problem.joints if joint is None else (joint,):
        part, e = problem.held[j], s.held[j]
        own = worth(problem, j, s.fitted[j], s.fitted[j]) if share is None else share
        memory = 3 * max(1, round(1.0 / own))
        for stretch in _stretches(part.at, part.run):
            pieces = max(1, round(len(stretch) / memory))
            for piece in np.array_split(e[stretch], pieces):
                w = piece * weights[j]
                errors.append(w)
                sse.append(float(w @ w))
                count.append(len(w))
        squares += float(e @ e)
        spread += float(np.sum((part.measured - np.mean(part.measured)) ** 2)) if len(e) else 0.0
    total = max(1, sum(count))
    flat = np.concatenate(errors) if errors else np.zeros(0)
    return HeldOut(flat, np.array(sse), np.array(count), math.sqrt(squares / total), math.sqrt(squares / (spread + 1e-300)))


def _stretches(at: np.ndarray, run: np.ndarray) -> list[np.ndarray]:
    """Index ranges of held-out samples without a gap of more than five samples."""
    if len(at) == 0:
        return []
    cut = np.flatnonzero((np.diff(at) > 5) | (np.diff(run) != 0)) + 1
    return np.split(np.arange(len(at)), cut)


def covariance(
    problem: Problem, s: Solution, weights: Mapping[int, float], rows: Sequence[dict[int, Row]]
) -> tuple[np.ndarray, list[slice]]:
    """Covariance of (theta, then of each term its coefficients and its shape), and the slice of each term.

    B = H^-1 (prior + sum over rows w^4 D' R D) H^-1 with R the Toeplitz matrix of the residual's autocovariance, tapered by a
    triangle over `LAGS` (W. K. Newey, K. D. West, Econometrica 55 (1987) 703); residuals are scaled by the effective number of
    samples less that of parameters.
    """
    P = len(problem.names)
    extra: list[np.ndarray] = []
    slices, at = [], P
    for i, t in enumerate(s.terms):
        C = s.columns[i][0]
        if t.law.shape_name:
            step = 1e-3 * max(abs(t.shape), 1e-9)
            moved = [problem.columns(Term(t.joint, t.law, t.shape + d), rows)[0] @ s.coefficients[i] for d in (-step, step)]
            C = np.column_stack([C, (moved[1] - moved[0]) / (2 * step)])
        extra.append(C)
        slices.append(slice(at, at + C.shape[1]))
        at += C.shape[1]
    scale = np.concatenate([problem.scale, *(1 / (np.sqrt(np.mean(C**2, axis=0)) + 1e-300) for C in extra)])
    H, S, effective = np.zeros((at, at)), np.zeros((at, at)), 0.0
    H[np.arange(P), np.arange(P)] = S[np.arange(P), np.arange(P)] = 1.0
    H[np.arange(P, at), np.arange(P, at)] = RIDGE
    if s.stiffness is not None:
        H[:P, :P] += s.stiffness
    for j in problem.joints:
        own = [i for i, t in enumerate(s.terms) if t.joint == j]
        index = np.concatenate([np.arange(P), *(np.arange(slices[i].start, slices[i].stop) for i in own)])
        D = np.hstack([problem.fitted[j].A, *(extra[i] for i in own)]) * scale[index]
        D[:, _given_way(problem, [s.terms[i] for i in own])] = 0.0
        w2 = weights[j] ** 2
        H[np.ix_(index, index)] += w2 * (D.T @ D)
        S[np.ix_(index, index)] += w2**2 * _sandwich(problem, j, D, s.fitted[j])
        effective += len(D) * worth(problem, j, s.fitted[j], s.fitted[j])
    inverted = inverse(H)
    used = float(np.trace(inverted @ (H - np.diag(np.concatenate([np.ones(P), np.zeros(at - P)])))))
    inflate = effective / max(effective - used, 0.1 * effective)
    V = inverted @ (S * inflate) @ inverted
    return V * np.outer(scale, scale), slices


def _band_limited(problem: Problem, left: np.ndarray, n: int, size: int) -> np.ndarray:
    """Power of white noise behind the filter, at the frequencies of a transform of ``size``, from the residual.

    The columns lie at the frequencies of the motion. There, least squares takes the noise out of the residual, whose own
    power says too little. Its level is taken between the frequencies at which the filter leaves `BAND` of an amplitude.
    """
    from scipy.signal import sosfreqz

    motion = problem.motions[0]
    angles = 2 * np.pi * np.arange(size // 2 + 1) / size / motion.every
    passed = np.abs(sosfreqz(motion.sos, angles)[1]) ** 2  # of an amplitude, forth and back
    band = (passed > BAND[0]) & (passed < BAND[1])
    periodogram = np.abs(np.fft.rfft(left, size)) ** 2 / n
    level = float(np.mean(periodogram[band]) / np.mean(passed[band] ** 4)) if band.any() else 0.0
    return np.asarray(level * passed**4)


def _sandwich(problem: Problem, joint: int, D: np.ndarray, e: np.ndarray) -> np.ndarray:
    """D' R D (K, K) with the tapered autocovariance of the residual, by the Fourier transform."""
    full, left = _spread(problem, joint, D), _spread(problem, joint, e)
    n = len(left)
    lags = min(round(LAGS / problem.dt), n // 4)
    r = float(e @ e) / len(e) * autocorrelation(left, lags) * (1 - np.arange(lags + 1) / (lags + 1))
    size = 1 << (n + lags).bit_length()
    kernel = np.zeros(size)
    kernel[: lags + 1] = r
    kernel[-lags:] = r[1:][::-1] if lags else 0.0
    power = np.maximum(np.fft.rfft(kernel).real, _band_limited(problem, left, len(e), size))
    F = np.fft.rfft(full, size, axis=0)
    twice = np.full(len(power), 2.0)
    twice[0] = twice[-1] = 1.0
    return np.asarray(((F.conj().T * (power * twice)) @ F).real / size)
