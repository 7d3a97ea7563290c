"""Whether a file that misses the error of the fit does so since its motion amplifies what is not known exactly."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from diagnose.verdict.reference import Case, Run, chi_square, error, judged
from diagnose.verdict.reference_fit import MOST_WORK, free_numbers, uncertainties, unshown_numbers
from diagnose.verdict.reference_runs import run_files, run_watched, too_far, work_of
from diagnose.verdict.reference_stage import APART
from diagnose.verdict.reference_verdict import MISSES
from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.mjcf import load_axis
from mjsim.mjcf.faithful import Faithful
from mjsim.plant import MujocoPlant
from simgap.bench import Bench

__all__ = ["is_sensitive", "refitted_with_starts"]

NUDGE = 1e-3  # of the noise of the angle, by which a start is moved to see whether a motion is sensitive
TWO = 2.0  # standard errors
SMALLEST = 1e-6  # of the travel, where no noise of the angle is known
RELATIVE = 1e-4  # change of a number that is one unit of the solver
OWN_STEP = 1e-3  # of a unit, or of a spread: slopes are as fine as a motion that amplifies them a thousandfold needs
OWN_SLOPES = 20.0  # a run for each slope: files of a twentieth of `MOST_WORK`, some 30 ms a run
ROUNDS_OF_OWN = 30
FAR = 1e3  # standard deviations: what a run that diverged is taken to miss


def is_sensitive(bench: Bench, path: Path, runs: Sequence[Run | None]) -> bool:
    """Whether the motion of a file cannot be followed.

    Either a start that differs by a thousandth of the angle's noise leads to a motion a fifth of the noise away, or the file
    errs by no more than two standard errors of its numbers make of it. Not asked of files that take more than `MOST_WORK`.
    """
    plant, cases = MujocoPlant.load(path), bench.nominal.cases
    if work_of(plant, cases) > MOST_WORK:
        return False
    starts, targets, missed = [], [], []
    for case, run in zip(cases, runs, strict=True):
        if run is None:
            return False
        angle = NUDGE * case.spread()[0] or SMALLEST * float(np.ptp(run.angle))
        starts.append(dataclasses.replace(run.start, angle=run.start.angle + angle))
        targets.append(judged(case, run))
        e = error(case, run)[case.estimation | case.held_out] / case.sigma
        missed.append(math.sqrt(max(0.0, float(np.mean(e**2)) - MISSES**2)))
    if not run_watched(plant, cases, starts, bench.threads, too_far(cases, targets, APART))[1]:
        return True
    by_numbers = uncertainties(load_axis(path), cases, [run.start for run in runs if run is not None])
    return all(m <= TWO * u for m, u in zip(missed, by_numbers, strict=True))


def refitted_with_starts(bench: Bench, axis: Axis, form: Faithful, runs: Sequence[Run | None]) -> Sequence[Run | None] | None:
    """Runs of every recording with numbers and starts refitted together in MuJoCo to the estimation data.

    The file is rewritten. None where that does not lower chi-square, or MuJoCo takes too long.
    """
    cases = bench.nominal.cases
    found = _refit(bench, axis, form, cases, runs)
    if found is None or not chi_square(cases, found[1])[0] < chi_square(cases, runs)[0]:
        return None
    better, fitted = found
    form.write(better, bench.out)
    free = bench.run(bench.out)
    return [a if c.estimation.any() else b for c, a, b in zip(cases, fitted, free, strict=True)]


def _refit(
    bench: Bench, axis: Axis, form: Faithful, cases: Sequence[Case], runs: Sequence[Run | None]
) -> tuple[Axis, Sequence[Run | None]] | None:
    """Least squares in MuJoCo over an axis's numbers and the starts, which are known to their spreads; slopes are MuJoCo's own.

    A motion that amplifies small changes has to be fitted in its numbers and its start at once, by the slopes of the very
    integrator. None where a run diverges, or would take too long.
    """
    if form.lacks or any(run is None for run in runs) or work_of(MujocoPlant.load(bench.out), cases) > MOST_WORK / OWN_SLOPES:
        return None
    now = free_numbers(axis, unshown_numbers(cases))
    found = [run.start for run in runs if run is not None]
    origins = [dataclasses.replace(c.start(), states=start.states) for c, start in zip(cases, found, strict=True)]
    moves = [(i, *m) for i, c in enumerate(cases) for m in zip(("angle", "velocity"), c.spread(), strict=True) if m[1] > 0.0]
    width, at = len(now), [(getattr(found[i], name) - getattr(origins[i], name)) / size for i, name, size in moves]

    with tempfile.TemporaryDirectory() as work:
        path = Path(work) / bench.out.name

        def changed(x: np.ndarray) -> Axis:
            values = zip(now.items(), x, strict=False)
            return axis.with_values({name: value * (1.0 + RELATIVE * float(d)) for (name, value), d in values})

        def run(x: np.ndarray) -> Sequence[Run | None]:
            form.write(changed(x), path)
            starts = list(origins)
            for (i, name, size), by in zip(moves, x[width:], strict=True):
                starts[i] = dataclasses.replace(starts[i], **{name: getattr(starts[i], name) + size * float(by)})
            return run_files([MujocoPlant.load(path)], cases, bench.threads, starts)[0]

        def residual(x: np.ndarray) -> np.ndarray:
            errors = [error(c, r)[c.estimation] / c.sigma for c, r in zip(cases, run(x), strict=True) if r is not None]
            short = len(errors) < len(cases)  # one diverged
            return np.concatenate(
                [*(np.full(int(c.estimation.sum()), FAR) for c in cases), x[width:]] if short else [*errors, x[width:]]
            )

        begin = np.concatenate([np.zeros(width), at])
        try:
            x = least_squares(residual, begin, x_scale="jac", diff_step=OWN_STEP, max_nfev=ROUNDS_OF_OWN).x
            return changed(x), run(x)
        except (InputError, ValueError):  # numbers that no file can have, or slopes that are not finite
            return None
