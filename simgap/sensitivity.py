"""Whether a file that misses the error of the fit does so since its motion amplifies what is not known exactly."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diagnose.result import Verdict
from diagnose.verdict.reference import Run, at_noise, error, figures, judged
from diagnose.verdict.reference_fit import MOST_WORK, refit_in_simulator, uncertainties
from diagnose.verdict.reference_runs import run_watched, too_far, work_of
from diagnose.verdict.reference_stage import APART
from diagnose.verdict.reference_verdict import MISSES
from mjsim.axis import Axis
from mjsim.mjcf import load_axis
from mjsim.mjcf.faithful import Faithful
from mjsim.plant import MujocoPlant
from simgap.bench import Bench

__all__ = ["error_by_every_recording", "is_sensitive"]

NUDGE = 1e-3  # of the noise of the angle, by which a start is moved to see whether a motion is sensitive
TWO = 2.0  # standard errors
SMALLEST = 1e-6  # of the travel, where no noise of the angle is known


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


def error_by_every_recording(bench: Bench, axis: Axis, form: Faithful, runs: Sequence[Run | None]) -> float:
    """Rms error in MuJoCo of the numbers refitted to estimation and held-out data together, where that is noise on both.

    NaN where it is not, where numbers alone were not the answer, and where MuJoCo takes too long. The structure then explains
    every recording; only the numbers are not known as exactly as the motion needs them.
    """
    if bench.result.verdict not in (Verdict.PARAMETERS_ONLY, Verdict.NO_MISMATCH) or bench.result.findings:
        return math.nan
    cases = bench.nominal.cases
    every = [dataclasses.replace(c, estimation=c.estimation | c.held_out, held_out=np.zeros_like(c.held_out)) for c in cases]
    starts = [case.start() if run is None else run.start for case, run in zip(cases, runs, strict=True)]
    found = refit_in_simulator(axis, form.write, bench.out.name, every, starts, bench.threads)
    if found is None or not at_noise(cases, found.runs):
        return math.nan
    return figures(every, found.runs).rms
