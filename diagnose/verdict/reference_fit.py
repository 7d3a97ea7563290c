"""A structure's numbers, refitted in the user's simulator or in the fitting engine.

Gauss-Newton with Levenberg's damping on the estimation data. In the simulator the residual is MuJoCo's and the Jacobian the
engine's, at the same numbers: they differ by numerics, which bend the response little, and a run of the engine costs a hundredth.
The horizon grows: the first parts of the recordings are fitted first, and where these alone miss the goal, no more is run.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from diagnose.thresholds import FAR, HORIZONS, SAME
from diagnose.verdict.reference import Case, Run, beyond, chi_square, error, noise_level
from diagnose.verdict.reference_runs import run_files, run_watched, work_of
from diagnose.verdict.reference_start import ROUNDS, run_surrogate
from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.mjcf import load_model
from mjsim.mjcf.faithful import Writer
from mjsim.mjcf.write import UNFAITHFUL
from mjsim.plant import MujocoPlant, Start

__all__ = [
    "MOST_WORK",
    "Refit",
    "free_numbers",
    "refit_in_engine",
    "refit_in_simulator",
    "standard_errors",
    "uncertainties",
    "unshown_numbers",
]

STEP = 3e-3  # relative step of the differences: above the jumps that events make, below what bends the response
FINE = 1e-4  # the same where a slope of an unstable motion is asked, which bends within less than `STEP`
DAMPINGS = (1e-3, 1e-1, 10.0)  # of the diagonal of the normal equations, in turn until the cost falls
LARGEST = 0.3  # relative change of a number in a step
MOST_WORK = 1e6  # of one run of all recordings (`work_of`), some .5 s: files that need more are not refitted

Runs = Sequence[Run | None]
Runner = Callable[[Axis, float], Runs | None]  # of an axis; may stop short of the end where chi-square exceeds the number


@dataclass(frozen=True, eq=False)
class Refit:
    """Numbers by name, the axis that has them, its runs on the recordings and their chi-square on the estimation data.

    errors: relative standard errors by name, from the last Jacobian; empty where none was needed.
    """

    values: Mapping[str, float]
    axis: Axis
    runs: Runs
    chi2: float
    errors: Mapping[str, float] = field(default_factory=dict)


def free_numbers(axis: Axis, held: Container[str] = ()) -> dict[str, float]:
    """The numbers that are refitted: linear parameters and the amplitudes of effects, as far as they are not zero.

    ``held``: names of numbers that stay, and keys of effects of which all do; those that the chain holds stay too.
    """
    values = {p.name: p.value for p in axis.chain.linear_parameters() if p.value}
    for e in axis.effects:
        if e.key not in held:
            values |= {f"{e.key}.{name}": e.values[name] for name in e.amplitudes if e.values[name]}
    return {name: value for name, value in values.items() if name not in held and name not in axis.chain.held}


def unshown_numbers(cases: Sequence[Case]) -> frozenset[str]:
    """Numbers that stay in a fit: with one of them free, all of a servo's log times one factor would fit alike."""
    return frozenset(name for case in cases for name in case.unshown)


def _residual(cases: Sequence[Case], runs: Runs | None) -> np.ndarray | None:
    """Estimation errors over the noise; None where a run diverged."""
    if runs is None or any(r is None for r in runs):
        return None
    return np.concatenate([error(c, r)[c.estimation] / c.sigma for c, r in zip(cases, runs, strict=True) if r is not None])


def _jacobian(
    axis: Axis, names: Sequence[str], cases: Sequence[Case], run: Runner, step: float = STEP, at: np.ndarray | None = None
) -> np.ndarray | None:  # fmt: skip
    """Slope of a prediction per relative change of each number (n, p); None where it diverges. ``at``: residual, if known."""
    at = _residual(cases, run(axis, math.inf)) if at is None else at
    if at is None:
        return None
    now = free_numbers(axis)
    columns = []
    for name in names:
        moved = _residual(cases, run(axis.with_values({name: now[name] * (1.0 + step)}), math.inf))
        columns.append(np.zeros(len(at)) if moved is None else (at - moved) / step)
    return np.column_stack(columns)


def _refit(
    axis: Axis,
    cases: Sequence[Case],
    run: Runner,
    engine: Runner,
    *,
    own_slopes: bool = False,
    metric: np.ndarray | None = None,
    held: Container[str] = (),
) -> Refit | None:
    """Least squares from the numbers of an axis; None where its run diverges or cannot be had.

    The Jacobian is the engine's while its steps lower the cost, and then, with ``own_slopes``, that of ``run`` itself, unless
    only noise is left. A step that promises less than a standard error of a number is not tried.
    metric (p,): least diagonal of the normal equations that damps a step: what a part of the data does not show, stays.
    held: as of `free_numbers`, what ``run`` does not respond to or the recordings cannot tell.
    """
    names, runs = list(free_numbers(axis, held)), run(axis, math.inf)
    e = _residual(cases, runs)
    if e is None or runs is None:
        return None
    best = Refit(free_numbers(axis, held), axis, runs, float(e @ e))
    slopes: list[Runner] = [engine, run] if own_slopes else [engine]
    errors: dict[str, float] = {}
    for _ in range(ROUNDS):
        J = _jacobian(best.axis, names, cases, slopes[0], at=e if slopes[0] is run else None)
        if J is None:
            break
        gram, slope = J.T @ J, J.T @ e
        errors = _errors(names, gram)
        scale = np.diag(gram) if metric is None else np.maximum(np.diag(gram), metric)
        worth = max(1.0, best.chi2 / len(e))  # less moves a number by less than its standard error
        if best.chi2 > FAR * len(e):  # other physics is missing
            worth = max(worth, SAME * best.chi2)
        promised = float(slope @ np.linalg.solve(gram + np.diag(DAMPINGS[0] * scale + 1e-12), slope))
        better = _step(best, gram, slope, scale, cases, run) if promised >= worth else None
        gained = 0.0 if better is None else best.chi2 - better.chi2
        if better is not None:
            best, e = better, _residual(cases, better.runs)
            assert e is not None
        if gained < worth:
            if len(slopes) == 1 or best.chi2 <= noise_level(len(e)):
                break
            slopes = slopes[1:]
    return replace(best, errors=errors)


def _step(
    best: Refit, gram: np.ndarray, slope: np.ndarray, scale: np.ndarray, cases: Sequence[Case], run: Runner
) -> Refit | None:
    """The first step that lowers the cost, of a few ever more damped ones; None where none does."""
    for damping in DAMPINGS:
        step = np.clip(np.linalg.solve(gram + np.diag(damping * scale + 1e-12), slope), -LARGEST, LARGEST)
        values = {n: v * (1.0 + float(s)) for (n, v), s in zip(best.values.items(), step, strict=True)}
        moved = best.axis.with_values(values)
        runs = run(moved, best.chi2)
        r = _residual(cases, runs)
        if r is not None and runs is not None and float(r @ r) < best.chi2:
            return Refit(values, moved, runs, float(r @ r))
    return None


def _covariance(gram: np.ndarray) -> np.ndarray:
    """Covariance (p, p) of relative changes from the normal equations of whitened residuals."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.asarray(np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale))


def _errors(names: Sequence[str], gram: np.ndarray) -> dict[str, float]:
    """Relative standard errors from the normal equations (p, p) of whitened residuals."""
    return {n: float(np.sqrt(max(v, 0.0))) for n, v in zip(names, np.diag(_covariance(gram)), strict=True)}


def standard_errors(axis: Axis, cases: Sequence[Case], starts: Sequence[Start]) -> dict[str, float]:
    """Relative standard errors of an axis's numbers by name, of the estimation data, by the slopes of the engine's free run.

    Only of numbers that a refit frees; empty where a run diverges.
    """
    fitted = [(c, s) for c, s in zip(cases, starts, strict=True) if c.estimation.any()]
    parts, at = [c for c, _ in fitted], [s for _, s in fitted]
    names = list(free_numbers(axis, unshown_numbers(cases)))
    J = _jacobian(axis, names, parts, _in_engine(parts, at, locked=False))
    return {} if J is None else _errors(names, J.T @ J)


def uncertainties(axis: Axis, cases: Sequence[Case], starts: Sequence[Start]) -> list[float]:
    """Rms over the noise by which the standard errors of an axis's numbers move its free run, on each recording.

    With J the slopes of the engine's free run and C = (J'J)^-1 of the estimation data, the square is the mean of diag(J C J').
    Infinite where a run diverges.
    """
    slopes = []
    for case, start in zip(cases, starts, strict=True):
        every = replace(case, estimation=case.estimation | case.held_out)
        J = _jacobian(
            axis, list(free_numbers(axis, unshown_numbers(cases))), [every], _in_engine([every], [start], locked=False), FINE
        )
        if J is None:
            return [math.inf] * len(cases)
        slopes.append(J)
    fitted = [J[c.estimation[c.estimation | c.held_out]] for J, c in zip(slopes, cases, strict=True)]
    covariance = _covariance(sum((J.T @ J for J in fitted), np.zeros((slopes[0].shape[1],) * 2)))
    return [math.sqrt(max(0.0, float(np.mean(np.sum((J @ covariance) * J, axis=1))))) for J in slopes]


def refit_in_simulator(
    axis: Axis, write: Writer, name: str, cases: Sequence[Case], starts: Sequence[Start], threads: int, goal: float = math.inf,
    *, own_slopes: bool = True,
) -> Refit | None:  # fmt: skip
    """Refit by plain MuJoCo, the file written by ``write``; the slopes are the engine's at first and, ``own_slopes``, MuJoCo's.

    Its runs are of the recordings with estimation data. ``goal``: largest chi-square on these data that is of use. None where
    it is missed, as soon as that is clear (what is not fitted yet cannot do better than noise), and where a run diverges, takes
    too long or cannot be written with other numbers.
    """
    fitted = [(c, s) for c, s in zip(cases, starts, strict=True) if c.estimation.any()]
    with tempfile.TemporaryDirectory() as work:
        out = Path(work) / name

        def load(some: Axis) -> MujocoPlant | None:
            try:
                write(some, out)
                return MujocoPlant.load(out)
            except InputError:
                return None

        first = load(axis)
        work_needed = math.inf if first is None else work_of(first, cases)
        if work_needed > MOST_WORK:
            return None
        best: Refit | None = None
        whole, at = [c for c, _ in fitted], [s for _, s in fitted]
        held = _left_out(axis, out) | unshown_numbers(cases)
        metric = _metric(axis, held, whole, at)
        for part in HORIZONS[1::3]:
            parts = [c.first(math.ceil(part * len(c.measured))) for c in whole]
            runs, engine = _in_simulator(load, parts, at, threads), _in_engine(parts, at, locked=False)
            own = (
                own_slopes and work_needed * len(free_numbers(axis, held)) <= MOST_WORK and part == HORIZONS[-1]
            )  # a run for each slope
            best = _refit(best.axis if best else axis, parts, runs, engine, own_slopes=own, metric=metric, held=held)
            if best is None or beyond(whole, best.runs, goal):
                return None
        return best


def _left_out(axis: Axis, path: Path) -> frozenset[str]:
    """Keys of the effects of an axis that MuJoCo does not step at all in a file written of it."""
    carried = load_model(path, bound={}).carried
    lacks = dict(carried.lacks) if carried else {}
    return frozenset(
        e.key for e in axis.effects if e.key in lacks and (UNFAITHFUL in lacks[e.key] or not e.native(axis.chain).values)
    )


def _metric(axis: Axis, held: Container[str], cases: Sequence[Case], starts: Sequence[Start]) -> np.ndarray | None:
    """Diagonal of the normal equations (p,) of all the data, by the engine; None where it diverges."""
    J = _jacobian(axis, list(free_numbers(axis, held)), cases, _in_engine(cases, starts, locked=False))
    return None if J is None else np.asarray(np.sum(J**2, axis=0))


def _in_simulator(
    load: Callable[[Axis], MujocoPlant | None], cases: Sequence[Case], starts: Sequence[Start], threads: int
) -> Runner:
    def run(some: Axis, limit: float) -> Runs | None:
        plant = load(some)
        if plant is None:
            return None
        if limit == math.inf:
            return run_files([plant], cases, threads, starts)[0]
        runs, whole = run_watched(plant, cases, starts, threads, lambda so_far: chi_square(cases, so_far)[0] > limit)
        return runs if whole else None

    return run


def refit_in_engine(axis: Axis, cases: Sequence[Case], starts: Sequence[Start]) -> Refit | None:
    """Refit by the fitting engine, from the same starts; its runs are of all recordings."""
    fitted = [i for i, c in enumerate(cases) if c.estimation.any()]
    run = _in_engine([cases[i] for i in fitted], [starts[i] for i in fitted], locked=True)
    found = _refit(axis, [cases[i] for i in fitted], run, run, held=unshown_numbers(cases))
    return None if found is None else replace(found, runs=_engine(found.axis, cases, starts, locked=True))


def _in_engine(cases: Sequence[Case], starts: Sequence[Start], *, locked: bool) -> Runner:
    return lambda some, limit: _engine(some, cases, starts, locked=locked)


def _engine(axis: Axis, cases: Sequence[Case], starts: Sequence[Start], *, locked: bool) -> Runs:
    return [run_surrogate(axis, c, s, locked=locked) for c, s in zip(cases, starts, strict=True)]
