"""Free runs beside the recordings: of a model file in plain MuJoCo, and of the fitting engine.

A run of MuJoCo costs a hundred times one of the engine. So where a run starts is found by the engine and only checked by MuJoCo,
and a run is watched: it is given up as soon as its first samples have settled what is asked of it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np

from diagnose.thresholds import HORIZONS, SIGMAS
from diagnose.verdict.reference import Case, Run, judged, noise_level
from diagnose.verdict.reference_start import OWN_STEP, ROUNDS, Shift, errors_of, suited
from mjsim.axis import Axis
from mjsim.mjcf.joint_limit import with_limit
from mjsim.mjcf.softness import with_softness
from mjsim.ode import DivergedError
from mjsim.plant import MujocoPlant, Start

__all__ = ["run_file", "run_files", "run_watched", "starts_of", "too_far", "work_of"]

DAMPED = (1.0, 0.3)  # parts of a Gauss-Newton step by MuJoCo

Useless = Callable[[Sequence[Run]], bool]


def work_of(plant: MujocoPlant, cases: Sequence[Case]) -> float:
    """What it takes to run a file once on every recording: steps times stages of the integrator times degrees of freedom."""
    model = plant.model
    stages = 4 if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 1
    return sum(len(c.recording) * c.recording.dt for c in cases) / float(model.opt.timestep) * stages * int(model.nv)


def starts_of(axis: Axis, cases: Sequence[Case]) -> list[Start]:
    """Where runs of an axis start, of each recording."""
    return [suited(axis, case)[0] for case in cases]


def run_file(plant: MujocoPlant, case: Case, start: Start | None = None) -> Run | None:
    """A free run of a file on a recording, from a given start or from that which suits both; None where it diverges.

    The engine says what suits; where MuJoCo's own errors ask for another start, that is tried too. Where a start off
    by its noise can explain the errors, MuJoCo's own slopes say which.
    """
    shift: Shift | None = None
    if start is None:
        source = plant.source
        start, shift = suited(with_limit(with_softness(source.axis, source), source) if source else None, case)
    first = _run(plant, case, start)
    if first is None or shift is None:
        return first
    best, shift = _tried(plant, case, first, shift, (1.0,))
    for _ in range(ROUNDS):
        before, at = errors_of(case, best), shift.moved
        if float(before @ before) <= noise_level(len(before)) or not shift.explains(before):
            break
        columns = []
        for k in range(len(at)):
            other = _run(plant, case, shift.start(at + OWN_STEP * (np.arange(len(at)) == k)))
            if other is None:
                return best
            columns.append((before - errors_of(case, other)) / OWN_STEP)
        best, shift = _tried(plant, case, best, dataclasses.replace(shift, responses=np.column_stack(columns)), DAMPED)
        if shift.moved is at:
            break
    return best


def _tried(plant: MujocoPlant, case: Case, first: Run, shift: Shift, parts: Sequence[float]) -> tuple[Run, Shift]:
    """The run from the start that the slopes promise, at the first part of the way that lowers the cost; else the first run."""
    e = errors_of(case, first)
    change, promised = shift.best(e)
    if promised < max(1.0, float(e @ e) / len(e)):  # no number of the start moves by a standard error
        return first, shift
    for part in parts:
        moved = np.clip(shift.moved + part * change, -SIGMAS, SIGMAS)
        second = _run(plant, case, shift.start(moved))
        rest = None if second is None else errors_of(case, second)
        if second is not None and rest is not None and rest @ rest + moved @ moved < e @ e + shift.moved @ shift.moved:
            return second, dataclasses.replace(shift, moved=moved)
    return first, shift


def _run(plant: MujocoPlant, case: Case, start: Start) -> Run | None:
    u, hold = case.drive()
    try:
        y = plant.run(u, case.recording.dt, start=start, hold=hold)
    except DivergedError:
        return None
    return Run(y[:, 0], y[:, 1], start)


def run_files(
    plants: Sequence[MujocoPlant], cases: Sequence[Case], threads: int, starts: Sequence[Start] | None = None
) -> list[list[Run | None]]:
    """``out[p][c]``: every file on every recording, side by side; ``starts``: of each recording, where they are known."""
    known: Sequence[Start | None] = starts or [None] * len(cases)
    with ThreadPoolExecutor(max(1, threads)) as pool:
        done = list(pool.map(lambda job: run_file(*job), [(p, c, s) for p in plants for c, s in zip(cases, known, strict=True)]))
    width = len(cases)
    return [done[i * width : (i + 1) * width] for i in range(len(plants))]


def run_watched(
    plant: MujocoPlant, cases: Sequence[Case], starts: Sequence[Start], threads: int, useless: Useless
) -> tuple[list[Run], bool]:
    """Runs of a file on every recording from given starts, and whether they went to the end.

    They stop, all at the same part of their recordings (`HORIZONS`), where one diverges or ``useless`` says so of what there is.
    """
    pieces = [_pieces(plant, case, start) for case, start in zip(cases, starts, strict=True)]
    runs = [Run(np.empty(0), np.empty(0), start) for start in starts]
    with ThreadPoolExecutor(max(1, threads)) as pool:
        for _ in HORIZONS:
            try:
                more = list(pool.map(next, pieces))
            except DivergedError:
                return runs, False
            runs = [
                Run(np.append(r.velocity, y[:, 0]), np.append(r.angle, y[:, 1]), r.start) for r, y in zip(runs, more, strict=True)
            ]
            if useless(runs):
                return runs, False
    return runs, True


def _pieces(plant: MujocoPlant, case: Case, start: Start) -> Iterator[np.ndarray]:
    u, hold = case.drive()
    ends = sorted({max(2, math.ceil(part * len(u))) for part in HORIZONS})
    yield from plant.pieces(u, case.recording.dt, start=start, hold=hold, ends=ends)
    while True:  # of a recording with fewer samples than horizons
        yield np.empty((0, 2))


def too_far(cases: Sequence[Case], targets: Sequence[np.ndarray], limit: float) -> Useless:
    """Of runs: whether the rms difference from ``targets`` (N,) is to exceed ``limit`` times the noise on a recording."""

    def useless(runs: Sequence[Run]) -> bool:
        sums = (float(np.sum((judged(c, r) - t[: len(r.angle)]) ** 2)) for c, r, t in zip(cases, runs, targets, strict=True))
        return any(s > (limit * c.sigma) ** 2 * len(t) for s, c, t in zip(sums, cases, targets, strict=True))

    return useless
