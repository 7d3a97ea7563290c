"""Free runs beside the recordings: of a model file in plain MuJoCo, and of the fitting engine.

A run of MuJoCo costs a hundred times one of the engine. So where a run starts is found by the engine and only checked by MuJoCo,
and a run is watched: it is given up as soon as its first samples have settled what is asked of it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import mujoco
import numpy as np

from diagnose.thresholds import HORIZONS, SIGMAS, SMALL
from diagnose.verdict.reference import Case, Run, judged, noise_level
from mjsim.axis import Axis
from mjsim.mjcf.joint_limit import with_limit
from mjsim.mjcf.softness import with_softness
from mjsim.ode import DivergedError, simulate
from mjsim.plant import MujocoPlant, Start
from mjsim.system import assemble

__all__ = ["run_file", "run_files", "run_surrogate", "run_watched", "starts_of", "too_far", "work_of"]

ROUNDS = 8  # Gauss-Newton steps of a start, or of a file's numbers
OWN_STEP, DAMPED = 0.1, (1.0, 0.3)  # standard deviations of a difference, parts of a step

Useless = Callable[[Sequence[Run]], bool]


@dataclass(frozen=True, eq=False)
class _Shift:
    """How far a start is moved, in standard deviations (s,), by name, and what a standard deviation does (n, s) to the errors."""

    names: tuple[str, ...]
    sizes: tuple[float, ...]
    responses: np.ndarray
    moved: np.ndarray

    def best(self, e: np.ndarray) -> tuple[np.ndarray, float]:
        """The change (s,) of the shift that suits errors e (n,) over the noise, and the fall of the cost that it promises."""
        x = self.responses
        change = np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ e - self.moved)
        after, total = e - x @ change, self.moved + change
        return change, float(e @ e + self.moved @ self.moved - after @ after - total @ total)

    def explains(self, e: np.ndarray) -> bool:
        """Whether a start as far off as one may be can make up what errors e (n,) over the noise have beyond noise."""
        most = SIGMAS**2 * float(np.sum(self.responses**2))
        return most >= float(e @ e) - len(e)

    def start(self, origin: Start, moved: np.ndarray) -> Start:
        """The start that is so far from the original one."""
        parts = zip(self.names, self.sizes, moved, strict=True)
        return dataclasses.replace(origin, **{n: getattr(origin, n) + size * float(m) for n, size, m in parts})


def work_of(plant: MujocoPlant, cases: Sequence[Case]) -> float:
    """What it takes to run a file once on every recording: steps times stages of the integrator times degrees of freedom."""
    model = plant.model
    stages = 4 if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 1
    return sum(len(c.recording) * c.recording.dt for c in cases) / float(model.opt.timestep) * stages * int(model.nv)


def run_surrogate(
    axis: Axis, case: Case, start: Start, *, locked: bool = True, along: np.ndarray | None = None
) -> Run | None:  # fmt: skip
    """The fitting engine's run on a recording; None where it diverges.

    ``locked``: laws that repeat over the angle follow the recorded one, as in a fit; else the run's own, as in MuJoCo. ``along``
    (N,): an angle that all laws follow, gravity and springs too.
    """
    r, chain = case.recording, axis.chain
    ratios = np.array([chain.total_ratio(i) for i in range(len(chain.bodies))])
    initial = np.array([start.angle * ratios, start.velocity * ratios])
    try:
        angle = (r.angle if along is None else along) if locked and not case.servo else None
        system = assemble(axis)
        y = simulate(
            system if along is None else system.tied(),
            r.input,
            r.dt,
            initial=initial,
            angle=angle,
            before=start.input,
            hold=r.hold,
        )
    except (DivergedError, ValueError):
        return None
    return Run(np.array(y.velocity), np.array(y.angle), start)


def _errors(case: Case, run: Run) -> np.ndarray:
    """Errors over the noise of all samples that count."""
    return np.asarray((case.measured - judged(case, run))[case.estimation | case.held_out] / case.sigma)


def _suited(axis: Axis | None, case: Case) -> tuple[Start, _Shift | None]:
    """Where a run of the engine starts that suits the recording best, each number as its noise allows.

    None beside it where the start is known, or changes nothing that shows.
    """
    start, spread = case.start(), zip(("angle", "velocity"), case.spread(), strict=True)
    moves = [(name, size) for name, size in spread if size > 0]
    first = run_surrogate(axis, case, start, locked=False) if axis is not None and moves else None
    if first is None or axis is None:
        return start, None
    e, found = _errors(case, first), []
    for name, size in moves:
        other = run_surrogate(axis, case, dataclasses.replace(start, **{name: getattr(start, name) + size}), locked=False)
        if other is not None:
            response = e - _errors(case, other)
            if math.sqrt(float(np.mean(response**2))) > SMALL:
                found.append((name, size, response))
    if not found:
        return start, None
    names, sizes, responses = zip(*found, strict=True)
    shift = _Shift(names, sizes, np.column_stack(responses), np.zeros(len(found)))
    moved, _ = shift.best(e)
    after = run_surrogate(axis, case, shift.start(start, moved), locked=False)
    if after is not None and np.max(np.abs(moved)) <= SIGMAS:
        rest = _errors(case, after)
        if rest @ rest + moved @ moved < e @ e:
            shift = dataclasses.replace(shift, moved=moved)
    return shift.start(start, shift.moved), shift


def starts_of(axis: Axis, cases: Sequence[Case]) -> list[Start]:
    """Where runs of an axis start, of each recording."""
    return [_suited(axis, case)[0] for case in cases]


def run_file(plant: MujocoPlant, case: Case, start: Start | None = None) -> Run | None:
    """A free run of a file on a recording, from a given start or from that which suits both; None where it diverges.

    The engine says what suits; where MuJoCo's own errors ask for another start, that is tried too. Where a start off
    by its noise can explain the errors, MuJoCo's own slopes say which.
    """
    shift: _Shift | None = None
    if start is None:
        source = plant.source
        start, shift = _suited(with_limit(with_softness(source.axis, source), source) if source else None, case)
    first = _run(plant, case, start)
    if first is None or shift is None:
        return first
    best, shift = _tried(plant, case, first, shift, (1.0,))
    for _ in range(ROUNDS):
        before, at = _errors(case, best), shift.moved
        if float(before @ before) <= noise_level(len(before)) or not shift.explains(before):
            break
        columns = []
        for k in range(len(at)):
            other = _run(plant, case, shift.start(case.start(), at + OWN_STEP * (np.arange(len(at)) == k)))
            if other is None:
                return best
            columns.append((before - _errors(case, other)) / OWN_STEP)
        best, shift = _tried(plant, case, best, dataclasses.replace(shift, responses=np.column_stack(columns)), DAMPED)
        if shift.moved is at:
            break
    return best


def _tried(plant: MujocoPlant, case: Case, first: Run, shift: _Shift, parts: Sequence[float]) -> tuple[Run, _Shift]:
    """The run from the start that the slopes promise, at the first part of the way that lowers the cost; else the first run."""
    e = _errors(case, first)
    change, promised = shift.best(e)
    if promised < max(1.0, float(e @ e) / len(e)):  # no number of the start moves by a standard error
        return first, shift
    for part in parts:
        moved = np.clip(shift.moved + part * change, -SIGMAS, SIGMAS)
        second = _run(plant, case, shift.start(case.start(), moved))
        rest = None if second is None else _errors(case, second)
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
