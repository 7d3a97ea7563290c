"""Score tests: how far chi-square falls, by a model linear in the amplitude, when an effect is added to a fitted structure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit, orthonormal
from diagnose.problem.hypothesis import make
from diagnose.structure.candidates import Candidate, inherit, replaced
from diagnose.thresholds import FAIR, SMALL
from mjsim.axis import Chain
from mjsim.effects import Effect, effect_class
from mjsim.effects.base import need_body

__all__ = ["QUARTERS", "Screened", "screen", "span", "unexplained_squares"]

QUARTERS = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)


@dataclass(frozen=True)
class Screened:
    """A candidate's best start and what a linearised fit says it would gain [chi-square]."""

    candidate: Candidate
    effect: Effect
    gain: float
    starts: tuple[Effect, ...]


def screen(fitter: Fitter, base: Fitted, supposed: Sequence[Candidate], replacing: Effect | None = None) -> list[Screened]:
    """The score test of each candidate beside a fitted base, largest gain first.

    The response of the candidate at its start (a secant) is made orthogonal to the base's own parameters; the residual's
    projection on it is the gain of chi-square that a linear model of the response would have, and the amplitude at which it has
    it. A phase, or another second direction (`Effect.second_direction`), enters as a second response. An amplitude of the wrong
    sign counts less. With ``replacing``, each candidate takes the place of that effect of the base, from which it inherits the
    parameters that they share; so does one that refines an effect of the nominal axis.
    """
    q = _spanned(base.fit)
    r0 = base.fit.residual
    present = tuple(e for e in base.effects if replacing is None or e.key != replacing.key)
    linear, own = base.linear, base.own
    starts: list[tuple[Candidate, Effect]] = []
    variants: list[list[Effect]] = []
    replaced_by = {c: replacing or replaced(base, c) for c in supposed}
    for candidate in supposed:
        cls, old = effect_class(candidate.id), replaced_by[candidate]
        for values in cls.starts(fitter.scales_for(cls, candidate.place)):
            if old is not None:
                values = inherit(cls, values, old, _torques(fitter.nominal.chain, old.place, candidate.place))
            effect = make(candidate.id, candidate.place, values)
            if old is None or "phase_rad" not in effect.values or "phase_rad" in old.values:
                starts.append((candidate, effect))
                second = effect.second_direction()
                variants.append([effect] if second is None else [effect, second])
            else:  # what comes in place of an effect is not moved: its phase is one of four
                turned = [effect.with_values({"phase_rad": effect.values["phase_rad"] + turn}) for turn in QUARTERS]
                starts += [(candidate, e) for e in turned]
                variants += [[e] for e in turned]
    tasks = [fitter.at_start(fitter.hypothesis((*present, e), linear, own)) for some in variants for e in some]
    answers = iter(fitter.run(tasks))
    responses = [[next(answers) for _ in some] for some in variants]
    project = partial(_project, r0=r0, q=q)
    projected = fitter.map([
        partial(project, effect, some, move=replaced_by[c] is None) for (c, effect), some in zip(starts, responses, strict=True)
    ])  # fmt: skip
    best: dict[Candidate, list[tuple[float, Effect]]] = {c: [] for c in supposed}
    for (candidate, _), scored in zip(starts, projected, strict=True):
        if scored is not None:
            best[candidate].append(scored)
    out = []
    for candidate, scored_starts in best.items():
        scored_starts.sort(key=lambda s: -s[0])
        if scored_starts:
            out.append(Screened(candidate, scored_starts[0][1], scored_starts[0][0], tuple(s[1] for s in scored_starts)))
    out.sort(key=lambda s: -s.gain)
    return out


def _torques(chain: Chain, place: str, other: str) -> float | None:
    """Torque at another place that does as much as one of 1 at a place; None where it is the same."""
    if place == other:
        return None
    return chain.total_ratio(need_body(chain, place)) / chain.total_ratio(need_body(chain, other))


def _project(
    effect: Effect, responses: list[np.ndarray | None], r0: np.ndarray, q: np.ndarray, *, move: bool
) -> tuple[float, Effect] | None:
    """(gain, start moved to the best amplitude and phase) for one start; None when it cannot be run."""
    columns: list[np.ndarray] = []
    for r in responses:
        if r is None or len(r) != len(r0):
            return None
        columns.append(r - r0)
    whole = np.column_stack(columns)
    D = whole - q @ (q.T @ whole)
    gram = D.T @ D
    if not np.all(np.diag(gram) > 0):
        return 0.0, effect
    c = D.T @ r0
    a = -_shown(gram, whole.T @ whole) @ c
    gain = float(-a @ c)
    cls = type(effect)
    amplitudes = cls.amplitudes
    if not move:
        return max(gain, 0.0), effect
    if len(a) == 2:
        effect, factor = effect.combined(float(a[0]), float(a[1]))
    else:
        factor = float(a[0])
    if amplitudes:
        signed = all(s.lower < 0 for s in cls.specs() if s.name in amplitudes)
        if factor < 0 and not signed:
            # far from the solution a secant may point the wrong way: it stays among the candidates, behind
            return FAIR * max(gain, 0.0), effect
        factor = float(np.sign(factor) * np.clip(abs(factor), 0.02, 20.0))
        moved = {n: effect.values[n] * factor for n in amplitudes}
        effect = make(effect.id, effect.place, {**effect.values, **moved})
    return max(gain, 0.0), effect


def _shown(gram: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """The inverse of a Gram matrix (n, n) of projected responses, without directions that the base takes up.

    Of those its parameters leave less than `SMALL` in amplitude of the responses themselves, whose Gram matrix is ``whole``: the
    torque of a spring at angle zero beside a zero of the angle that is fitted. The direction that is left most stays.
    """
    values, vectors = np.linalg.eigh(gram)
    left = values / np.einsum("ij,ik,kj->j", vectors, whole, vectors)
    shown = left >= min(SMALL**2, float(np.max(left)))
    inverse: np.ndarray = (vectors[:, shown] / values[shown]) @ vectors[:, shown].T
    return inverse


def span(f: Fitted) -> np.ndarray | None:
    """Orthonormal columns that span what the parameters of a fit can take up; None of one that could not be run."""
    return _spanned(f.fit) if f.ok else None


@lru_cache(2)  # the same is asked of a base, and of that at the nominal parameters, for every neighbour
def _spanned(fit: Fit) -> np.ndarray:
    return orthonormal(fit.J)


def unexplained_squares(residual: np.ndarray | None, taken: np.ndarray | None) -> float:
    """Squares of a residual (N,) beside what orthonormal columns (N, p) take up; inf where there is none."""
    if residual is None:
        return math.inf
    squares = float(residual @ residual)
    return squares if taken is None or len(residual) != len(taken) else squares - float(np.sum((taken.T @ residual) ** 2))
