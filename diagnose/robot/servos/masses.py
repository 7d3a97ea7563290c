"""Masses that all servo joints carry together: fitted for the whole robot, with the own numbers of every joint free.

A joint runs by itself, so that the errors of different joints share nothing but the masses x. The normal equations of the own
numbers of each joint j and of x are an arrow, of which the Schur complement is the information on x:

    S = sum over j of C_j' C_j - C_j' J_j (J_j' J_j)^-1 J_j' C_j

J_j, C_j: derivatives of the weighted errors of joint j by its own numbers and by x. A mass that one joint alone would take into
its gains is determined by the others. Source: J. Nocedal, S. J. Wright, Numerical Optimization (2006), ch. 10.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.evidence.held_out import Comparison, compare
from diagnose.fit.fitted import HeldOut
from diagnose.robot.linear import inverse, solved
from diagnose.robot.servos.fit import BLOCK, Fit, block_weights, jacobian, prior_errors, slots_of
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.starts import THIN
from diagnose.robot.servos.state import JointSearch, Structure, held_out

__all__ = ["UNSEEN", "Loaded", "fit_masses", "gain_of", "information"]

STEP = 0.01  # of the differences, of a number's scale
MOST = 12  # iterations
ENDS = 1e-4  # relative decrease of the sum of squares below which an iteration is the last
ROUNDS = 3  # of weights: errors fall by different factors at different joints
LARGEST = 0.5  # change of a mass in one iteration, of its scale
UNSEEN = 1e-6  # of the information on a mass under fixed own numbers: the rest beside them is rounding


@dataclass(frozen=True, eq=False)
class Loaded:
    """Structures of all joints under common masses x (C,) less those of the file and their covariance (C, C)."""

    x: np.ndarray
    variance: np.ndarray
    structures: tuple[Structure, ...]


@dataclass(frozen=True, eq=False)
class _Joint:
    """One joint in a robot-wide fit: samples that are fitted, structure, coded own numbers (P,), weights (n,)."""

    part: JointProblem
    structure: Structure
    x: np.ndarray
    weights: np.ndarray

    def errors(self, masses: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Weighted errors of the fitted samples, then those of the priors."""
        fit = self.structure.fit
        p = self.part.with_masses(masses)
        e = (self.weights * p.error(slots_of(p, fit.numbers, x, fit.slots)))[p.fitted]
        return np.concatenate([e, prior_errors(fit.numbers, x)])

    def derivatives(self, masses: np.ndarray, free: Sequence[int], scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J (n, P) by the own numbers, C (n, F) by the free masses over their scales; the priors' rows last."""
        fit = self.structure.fit
        J = jacobian(self.part.with_masses(masses), fit.numbers, self.x, fit.slots, self.weights)
        C = np.empty((len(J), len(free)))
        for i, k in enumerate(free):
            ends = []
            for s in (STEP, -STEP):
                moved = masses.copy()
                moved[k] += s * scales[k]
                ends.append(self.errors(moved, self.x))
            C[:, i] = (ends[0] - ends[1]) / (2 * STEP)
        return J, C


def _joint(s: JointSearch, structure: Structure, weights: np.ndarray) -> _Joint:
    part = s.problem.as_given.windows(THIN)
    return _Joint(part, structure, structure.fit.x, weights[part.rows])


def fit_masses(
    searches: Sequence[JointSearch], structures: Sequence[Structure], start: np.ndarray, free: Sequence[int], scales: np.ndarray
) -> Loaded:
    """The least-squares masses with the numbers of the structures free.

    free: indices of the masses that are fitted from ``start`` (C,), the others stay; scales (C,): of the masses.
    """
    x, now = start.copy(), list(structures)
    weights = [t.fit.weights for t in now]
    for _ in range(ROUNDS if free else 1):
        joints = [_joint(s, t, w) for s, t, w in zip(searches, now, weights, strict=True)]
        x, joints = _least(joints, x, free, scales)
        now = [_counted(s, j, x, w) for s, j, w in zip(searches, joints, weights, strict=True)]
        weights = [block_weights(s.problem, t.fit.error) for s, t in zip(searches, now, strict=True)]
    variance = np.zeros((len(x), len(x)))
    if free:
        joints = [_joint(s, t, w) for s, t, w in zip(searches, now, weights, strict=True)]
        variance[np.ix_(free, free)] = _covariance(joints, x, free, scales)
    return Loaded(x, variance, tuple(now))


def _counted(s: JointSearch, j: _Joint, x: np.ndarray, weights: np.ndarray) -> Structure:
    """The structure of a joint with its fitted numbers, its errors of all samples."""
    fit, p = j.structure.fit, s.problem.with_masses(x)
    slots = slots_of(p, fit.numbers, j.x, fit.slots)
    error = p.error(slots)
    r = np.concatenate([(weights * error)[p.fitted], prior_errors(fit.numbers, j.x)])
    return Structure(j.structure.laws, Fit(fit.numbers, j.x, slots, error, float(r @ r), weights))


def _least(joints: Sequence[_Joint], x: np.ndarray, free: Sequence[int], scales: np.ndarray) -> tuple[np.ndarray, list[_Joint]]:
    """Levenberg-Marquardt on masses and own numbers."""
    now, at = list(joints), list(free)
    best, damping = _total(now, x), 1e-3
    for _ in range(MOST):
        parts = [(j.errors(x, j.x), *j.derivatives(x, at, scales)) for j in now]
        before = best
        for _ in range(6):
            step, own = _step(parts, damping)
            trial = x.copy()
            trial[at] += np.clip(step, -LARGEST, LARGEST) * scales[at]
            moved = [dataclasses.replace(j, x=j.x + d) for j, d in zip(now, own, strict=True)]
            new = _total(moved, trial)
            if new < best:
                x, now, best, damping = trial, moved, new, max(damping / 5, 1e-7)
                break
            damping *= 5
        if before - best < ENDS * before:
            break
    return x, now


def _total(joints: Sequence[_Joint], x: np.ndarray) -> float:
    return sum(float(r @ r) for r in (j.errors(x, j.x) for j in joints))


Parts = Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]


def _step(parts: Parts, damping: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """Step of the masses over their scales, and of the own numbers of each joint; parts: (r, J, C) of each."""
    free = parts[0][2].shape[1]
    S, g, blocks = np.zeros((free, free)), np.zeros(free), []
    for r, J, C in parts:
        H, B = J.T @ J, J.T @ C
        H = H + damping * np.diag(np.diag(H) + 1e-9 * np.trace(H) + 1e-30)
        HB, Hg = solved(H, B), solved(H, J.T @ r)
        D = C.T @ C
        S, g = S + D + damping * np.diag(np.diag(D)) - B.T @ HB, g + C.T @ r - B.T @ Hg
        blocks.append((HB, Hg))
    step = -solved(S, g) if free else np.zeros(0)
    return step, [-(Hg + HB @ step) for HB, Hg in blocks]


def information(
    searches: Sequence[JointSearch], now: Loaded, scales: np.ndarray, selected: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """(gain (C,), share (C,)): what the weighted sum of squares loses by each mass beside those selected, to first order, and the
    part of the information on it that the other numbers leave."""
    every = list(range(len(scales)))
    joints = [_joint(s, t, t.fit.weights) for s, t in zip(searches, now.structures, strict=True)]
    S, g, raw = np.zeros((len(every),) * 2), np.zeros(len(every)), np.zeros(len(every))
    for j in joints:
        r, (J, C) = j.errors(now.x, j.x), j.derivatives(now.x, every, scales)
        H = J.T @ J + 1e-12 * np.diag(np.diag(J.T @ J) + 1e-30)
        S, g = S + C.T @ C - C.T @ J @ solved(H, J.T @ C), g + C.T @ r - C.T @ J @ solved(H, J.T @ r)
        raw += np.sum(C**2, axis=0)
    kept = list(selected)
    gain, share = np.zeros(len(every)), np.zeros(len(every))
    for c in (k for k in every if k not in kept):
        own, slope = S[c, c], g[c]
        if kept:
            along = solved(S[np.ix_(kept, kept)], S[kept, c])
            own, slope = own - float(along @ S[kept, c]), slope - float(along @ g[kept])
        share[c] = own / (raw[c] + 1e-300)
        gain[c] = slope**2 / own if share[c] > UNSEEN else 0.0
    return gain, share


def _covariance(joints: Sequence[_Joint], x: np.ndarray, free: Sequence[int], scales: np.ndarray) -> np.ndarray:
    """Covariance (F, F) of the masses in their units, cluster-robust over blocks of `BLOCK` of all joints; at least
    that of the weights.

    Source: K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13.
    """
    S = np.zeros((len(free),) * 2)
    scores: dict[int, np.ndarray] = {}
    for j in joints:
        r, (J, C) = j.errors(x, j.x), j.derivatives(x, free, scales)
        H = J.T @ J + 1e-12 * np.diag(np.diag(J.T @ J) + 1e-30)
        beside = C - J @ solved(H, J.T @ C)  # what of the derivatives the own numbers do not take
        S += beside.T @ C
        n = int(j.part.fitted.sum())
        for block, row in zip(j.part.blocks(BLOCK)[j.part.fitted], beside[:n] * r[:n, None], strict=True):
            scores[int(block)] = scores.get(int(block), np.zeros(len(free))) + row
    inverted = inverse(S)
    K = np.array(list(scores.values()))
    robust = inverted @ (len(K) / max(len(K) - len(free), 1) * K.T @ K) @ inverted
    least = np.diag(inverted)
    larger = np.sqrt(np.maximum(least / np.maximum(np.diag(robust), 1e-12 * least), 1.0))
    at = scales[list(free)]
    return np.asarray(robust * np.outer(larger, larger) * np.outer(at, at))


def gain_of(
    searches: Sequence[JointSearch], poorer: Sequence[Structure], richer: Sequence[Structure]
) -> tuple[float, float, Comparison]:
    """Gain of one set of structures over another, all joints together: fitted, less the price of the laws; held out; and the
    comparison of the paired held-out blocks of all joints."""
    fitted = held = 0.0
    before, after = [], []
    for s, a, b in zip(searches, poorer, richer, strict=True):
        counting = dataclasses.replace(s, now=a)
        step = counting.step(a, b)
        fitted, held = fitted + step.gain, held + step.likelihood
        difference = a.fit.error - b.fit.error
        before.append(held_out(s.problem, a.fit.error, a.fit.weights, difference, b.fit.error))
        after.append(held_out(s.problem, b.fit.error, a.fit.weights, difference, b.fit.error))
    return fitted, held, compare(_pooled(before), _pooled(after))


def _pooled(parts: Sequence[HeldOut]) -> HeldOut:
    errors, sse, n = (np.concatenate([getattr(x, k) for x in parts]) for k in ("errors", "sse", "n"))
    return HeldOut(errors, sse, n, math.nan, math.nan)
