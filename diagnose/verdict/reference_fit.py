"""A structure's numbers, refitted in the user's simulator or in the fitting engine.

Gauss-Newton with Levenberg's damping on the estimation data. In the simulator the residual is MuJoCo's and the Jacobian the
engine's, at the same numbers: they differ by numerics, which bend the response little, and a run of the engine costs a hundredth.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diagnose.verdict.reference import Case, Run, chi_square, error, run_files, run_surrogate
from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.mjcf.faithful import Writer
from mjsim.plant import MujocoPlant, Start

__all__ = ["Refit", "refit_in_engine", "refit_in_simulator"]

ROUNDS = 6  # Gauss-Newton steps
STEP = 3e-3  # relative step of the differences: above the jumps that events make, below what bends the response
DAMPING = 1e-3  # of the diagonal of the normal equations
LARGEST = 0.3  # relative change of a number in a step
ENOUGH = 1.0  # fall of chi-square below which a step is the last: one number is known to one standard error anyway

Runs = Sequence[Run | None]


@dataclass(frozen=True, eq=False)
class Refit:
    """Numbers by name, the axis that has them, its runs and their chi-square on the estimation data."""

    values: Mapping[str, float]
    axis: Axis
    runs: Runs
    chi2: float


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


def _jacobian(axis: Axis, names: Sequence[str], cases: Sequence[Case], engine: Callable[[Axis], Runs]) -> np.ndarray | None:
    """Slope of the engine's prediction per relative change of each number (n, p); None where it diverges."""
    at = _residual(cases, engine(axis))
    if at is None:
        return None
    now = _free(axis)
    columns = []
    for name in names:
        moved = _residual(cases, engine(axis.with_values({name: now[name] * (1.0 + STEP)})))
        columns.append(np.zeros(len(at)) if moved is None else (at - moved) / STEP)
    return np.column_stack(columns)


def _refit(axis: Axis, cases: Sequence[Case], run: Callable[[Axis], Runs | None], engine: Callable[[Axis], Runs]) -> Refit | None:
    """Least squares from the numbers of an axis; None where its run diverges or cannot be had."""
    names, runs = list(_free(axis)), run(axis)
    e = _residual(cases, runs)
    if e is None or runs is None:
        return None
    best = Refit(_free(axis), axis, runs, chi_square(cases, runs)[0])
    damping = DAMPING
    for _ in range(ROUNDS):
        J = _jacobian(best.axis, names, cases, engine)
        if J is None:
            break
        gram = J.T @ J
        gram[np.diag_indices(len(names))] += damping * np.diag(gram) + 1e-12
        step = np.clip(np.linalg.solve(gram, J.T @ e), -LARGEST, LARGEST)
        values = {n: v * (1.0 + float(s)) for (n, v), s in zip(best.values.items(), step, strict=True)}
        moved = best.axis.with_values(values)
        runs = run(moved)
        r = _residual(cases, runs)
        if r is None or runs is None or float(r @ r) >= best.chi2:
            damping *= 100.0
            if damping > 1.0:
                break
            continue
        gained, e = best.chi2 - float(r @ r), r
        best = Refit(values, moved, runs, float(r @ r))
        if gained < ENOUGH:
            break
    return best


def refit_in_simulator(
    axis: Axis, write: Writer, name: str, cases: Sequence[Case], starts: Sequence[Start], threads: int
) -> Refit | None:
    """Refit by plain MuJoCo, the file written by ``write``; None where it diverges or cannot be written with other numbers."""

    def run(some: Axis) -> Runs | None:
        with tempfile.TemporaryDirectory() as work:
            out = Path(work) / name
            try:
                write(some, out)
                return run_files([MujocoPlant.load(out)], cases, threads, starts)[0]
            except InputError:
                return None

    return _refit(axis, cases, run, lambda some: _engine(some, cases, starts, locked=False))


def refit_in_engine(axis: Axis, cases: Sequence[Case], starts: Sequence[Start]) -> Refit | None:
    """Refit by the fitting engine, from the same starts."""

    def run(some: Axis) -> Runs:
        return _engine(some, cases, starts, locked=True)

    return _refit(axis, cases, run, run)


def _engine(axis: Axis, cases: Sequence[Case], starts: Sequence[Start], *, locked: bool) -> Runs:
    return [run_surrogate(axis, c, s, locked=locked) for c, s in zip(cases, starts, strict=True)]
