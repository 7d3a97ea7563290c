"""A structure's numbers, refitted in the user's simulator or in the fitting engine.

Gauss-Newton with Levenberg's damping on the estimation data. In the simulator the residual is MuJoCo's and the Jacobian the
engine's, at the same numbers: they differ by numerics, which bend the response little, and a run of the engine costs a hundredth.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from diagnose.verdict.reference import Case, Run, chi_square, error, run_files, run_surrogate, work_of
from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.mjcf.faithful import Writer
from mjsim.plant import MujocoPlant, Start

__all__ = ["MOST_WORK", "Refit", "refit_in_engine", "refit_in_simulator"]

ROUNDS = 8  # Gauss-Newton steps
STEP = 3e-3  # relative step of the differences: above the jumps that events make, below what bends the response
DAMPINGS = (1e-3, 1e-1, 10.0)  # of the diagonal of the normal equations, in turn until the cost falls
LARGEST = 0.3  # relative change of a number in a step
MOST_WORK = 1e6  # of one run of all recordings (`work_of`), some .5 s: files that need more are not refitted
MOST_SLOPES = 1e5  # the same, up to which MuJoCo's own differences are taken where the engine's Jacobian does not serve
ENOUGH = 1.0  # fall of chi-square below which a step is the last: one number is known to one standard error anyway

Runs = Sequence[Run | None]


@dataclass(frozen=True, eq=False)
class Refit:
    """Numbers by name, the axis that has them, its runs and their chi-square on the estimation data.

    errors: relative standard errors by name, from the last Jacobian; empty where none was needed.
    """

    values: Mapping[str, float]
    axis: Axis
    runs: Runs
    chi2: float
    errors: Mapping[str, float] = field(default_factory=dict)


def _free(axis: Axis) -> dict[str, float]:
    """The numbers that are refitted: linear parameters and the amplitudes of effects, as far as they are not zero."""
    values = {p.name: p.value for p in axis.chain.linear_parameters() if p.value}
    for e in axis.effects:
        values |= {f"{e.key}.{name}": e.values[name] for name in e.amplitudes if e.values[name]}
    return values


def _residual(cases: Sequence[Case], runs: Runs | None) -> np.ndarray | None:
    """Estimation errors over the noise; None where a run diverged."""
    if runs is None or any(r is None for r in runs):
        return None
    return np.concatenate([error(c, r)[c.estimation] / c.sigma for c, r in zip(cases, runs, strict=True) if r is not None])


def _jacobian(axis: Axis, names: Sequence[str], cases: Sequence[Case], run: Callable[[Axis], Runs | None]) -> np.ndarray | None:
    """Slope of a prediction per relative change of each number (n, p); None where it diverges."""
    at = _residual(cases, run(axis))
    if at is None:
        return None
    now = _free(axis)
    columns = []
    for name in names:
        moved = _residual(cases, run(axis.with_values({name: now[name] * (1.0 + STEP)})))
        columns.append(np.zeros(len(at)) if moved is None else (at - moved) / STEP)
    return np.column_stack(columns)


def _refit(
    axis: Axis,
    cases: Sequence[Case],
    run: Callable[[Axis], Runs | None],
    engine: Callable[[Axis], Runs],
    *,
    own_slopes: bool = False,
) -> Refit | None:
    """Least squares from the numbers of an axis; None where its run diverges or cannot be had.

    The Jacobian is the engine's while its steps lower the cost, and then, with ``own_slopes``, that of ``run`` itself.
    """
    names, runs = list(_free(axis)), run(axis)
    e = _residual(cases, runs)
    if e is None or runs is None:
        return None
    best = Refit(_free(axis), axis, runs, chi_square(cases, runs)[0])
    slopes: list[Callable[[Axis], Runs | None]] = [engine, run] if own_slopes else [engine]
    errors: dict[str, float] = {}
    for _ in range(ROUNDS):
        J = _jacobian(best.axis, names, cases, slopes[0])
        if J is None:
            break
        errors = _errors(names, J.T @ J)
        better = _step(best, e, J, cases, run)
        gained = 0.0 if better is None else best.chi2 - better.chi2
        if better is not None:
            best, e = better, _residual(cases, better.runs)
            assert e is not None
        if gained < ENOUGH:
            if len(slopes) == 1:
                break
            slopes = slopes[1:]
    return replace(best, errors=errors)


def _step(best: Refit, e: np.ndarray, J: np.ndarray, cases: Sequence[Case], run: Callable[[Axis], Runs | None]) -> Refit | None:
    """The first step that lowers the cost, of a few ever more damped ones; None where none does."""
    for damping in DAMPINGS:
        gram = J.T @ J
        gram[np.diag_indices(len(gram))] += damping * np.diag(gram) + 1e-12
        step = np.clip(np.linalg.solve(gram, J.T @ e), -LARGEST, LARGEST)
        values = {n: v * (1.0 + float(s)) for (n, v), s in zip(best.values.items(), step, strict=True)}
        moved = best.axis.with_values(values)
        runs = run(moved)
        r = _residual(cases, runs)
        if r is not None and runs is not None and float(r @ r) < best.chi2:
            return Refit(values, moved, runs, float(r @ r))
    return None


def _errors(names: Sequence[str], gram: np.ndarray) -> dict[str, float]:
    """Relative standard errors from the normal equations (p, p) of whitened residuals."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-12)
    return {n: float(np.sqrt(inverse[i, i]) / scale[i]) for i, n in enumerate(names)}


def refit_in_simulator(
    axis: Axis, write: Writer, name: str, cases: Sequence[Case], starts: Sequence[Start], threads: int
) -> Refit | None:
    """Refit by plain MuJoCo, the file written by ``write``.

    None where it diverges, takes too long or cannot be written with other numbers.
    """

    with tempfile.TemporaryDirectory() as work:
        out = Path(work) / name

        def load(some: Axis) -> MujocoPlant | None:
            try:
                write(some, out)
                return MujocoPlant.load(out)
            except InputError:
                return None

        def run(some: Axis) -> Runs | None:
            plant = load(some)
            return None if plant is None else run_files([plant], cases, threads, starts)[0]

        first = load(axis)
        work_needed = math.inf if first is None else work_of(first, cases)
        if work_needed > MOST_WORK:
            return None
        return _refit(
            axis, cases, run, lambda some: _engine(some, cases, starts, locked=False), own_slopes=work_needed <= MOST_SLOPES
        )


def refit_in_engine(axis: Axis, cases: Sequence[Case], starts: Sequence[Start]) -> Refit | None:
    """Refit by the fitting engine, from the same starts."""

    def run(some: Axis) -> Runs:
        return _engine(some, cases, starts, locked=True)

    return _refit(axis, cases, run, run)


def _engine(axis: Axis, cases: Sequence[Case], starts: Sequence[Start], *, locked: bool) -> Runs:
    return [run_surrogate(axis, c, s, locked=locked) for c, s in zip(cases, starts, strict=True)]
