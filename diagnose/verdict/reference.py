"""The user's simulator as the judge: a model file, stepped by plain MuJoCo with its own options, beside the recordings.

A free run starts where the recording does: at its first angle, corrected by what its noise allows, and at rest or at the speed
that the first samples tell. Errors are those of the measured velocity (the rate of the angle where no velocity was recorded), or
of the measured angle where a servo follows a command.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import mujoco
import numpy as np

from diagnose.data.experiment import hold_out_blocks, measured_velocity, plain_step, prepare, without_derived_velocity
from diagnose.data.noise import white_noise_level
from diagnose.result import FitFigures
from mjsim.axis import Axis
from mjsim.ode import DivergedError, simulate
from mjsim.plant import Hold, MujocoPlant, Start
from mjsim.recording import Recording

__all__ = [
    "Case",
    "Run",
    "at_noise",
    "cases_of",
    "chi_square",
    "error",
    "figures",
    "judged",
    "run_file",
    "run_files",
    "run_surrogate",
    "work_of",
]

KNOWN = 0.05  # relative error of a noise variance that is taken from the fastest part of a signal
CLEAR = 3.0  # standard deviations of a mean square of white noise, which are sqrt(2 / n)
FIRST = 0.005  # [s] over which the speed at the first sample is a straight line, at least two samples
FELT = 0.05  # of the noise, rms: least response to a start one standard deviation off, for the start to be refined


@dataclass(frozen=True, eq=False)
class Case:
    """A recording to be judged: which of its N samples belong to the estimation and to the held-out data, and its noise.

    measured (N,): the judged velocity, or the angle of a servo; sigma: its noise rms; moving: whether the axis moves at the
    first sample.
    """

    recording: Recording
    measured: np.ndarray
    sigma: float
    moving: bool
    estimation: np.ndarray
    held_out: np.ndarray

    def start(self) -> Start:
        """Where the recording starts, by its first samples."""
        r = self.recording
        angle = float(r.angle[0]) if r.angle is not None else 0.0
        if self.servo:
            return Start(angle, 0.0, float(r.input[0]))
        if not self.moving:
            return Start(angle)
        few = max(2, min(len(r), round(FIRST / r.dt)))
        speed = float(np.polynomial.Polynomial.fit(np.arange(few), self.measured[:few], 1)(0.0))
        return Start(angle, speed, float(r.input[0]))

    def spread(self) -> tuple[float, float]:
        """Standard deviations of the starting angle and velocity; 0 of one that is known."""
        q = self.recording.angle
        angle = 0.0 if q is None else max(white_noise_level(q), plain_step(q) / math.sqrt(12.0))
        return angle, self.sigma if self.moving and not self.servo else 0.0

    @property
    def servo(self) -> bool:
        """Whether the input is the command of a servo."""
        return self.recording.command is not None

    def drive(self) -> tuple[np.ndarray, Hold]:
        """Input (N, 1) of a plant, and how it goes between samples."""
        u, hold = self.recording.input, Hold(self.recording.hold)
        if hold is Hold.MEAN:  # of the sample that begins with the row; a plant takes that of the sample that ends with it
            u = np.concatenate([u[:1], u[:-1]])
        return u[:, None], hold


@dataclass(frozen=True, eq=False)
class Run:
    """A free run of one case: velocity and angle (N,), and where it started."""

    velocity: np.ndarray
    angle: np.ndarray
    start: Start


def cases_of(recordings: Sequence[Recording], held_out: Sequence[Recording]) -> tuple[Case, ...]:
    """Every recording once, split as the diagnosis splits them: by recording, else by blocks."""
    out = []
    for role, group in (("estimation", recordings), ("held-out", held_out)):
        for given in group:
            r = without_derived_velocity(given)
            e = prepare(r)
            mine, other = (e.counts, np.zeros(len(r), bool))
            if not held_out:
                mine, other = (e.counts & part for part in hold_out_blocks(r))
            elif role == "held-out":
                mine, other = other, mine
            measured = measured_velocity(r) if r.command is None or r.angle is None else r.angle
            out.append(Case(r, measured, e.sigma, e.moving, mine, other))
    return tuple(out)


def _run(y: np.ndarray, start: Start) -> Run:
    """Of the outputs (N, 2) of a plant: velocity and angle."""
    return Run(y[:, 0], y[:, 1], start)


def judged(case: Case, run: Run) -> np.ndarray:
    """What of a run (N,) is compared with what was measured."""
    if case.servo:
        return run.angle
    return run.velocity if case.recording.velocity is not None else np.gradient(run.angle, case.recording.dt)


def work_of(plant: MujocoPlant, cases: Sequence[Case]) -> float:
    """What it takes to run a file once on every recording: steps times stages of the integrator times degrees of freedom."""
    model = plant.model
    stages = 4 if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 1
    return sum(len(c.recording) * c.recording.dt for c in cases) / float(model.opt.timestep) * stages * int(model.nv)


def run_file(plant: MujocoPlant, case: Case, start: Start | None = None) -> Run | None:
    """A free run of a file on a recording, from a given start or from that which suits both; None where it diverges."""
    r = case.recording
    u, hold = case.drive()
    if start is not None:
        try:
            y = plant.run(u, r.dt, start=start, hold=hold)
            return Run(y[:, 0], y[:, 1], start)
        except DivergedError:
            return None
    start = case.start()
    shifts = [s for s in zip(("angle", "velocity"), case.spread(), strict=True) if s[1] > 0]
    starts = [start, *(dataclasses.replace(start, **{n: getattr(start, n) + s}) for n, s in shifts)]
    try:
        outputs = plant.run_many([u] * len(starts), r.dt, starts, hold=hold)
    except DivergedError:
        return None
    y = outputs[0]
    first = judged(case, _run(y, start))
    responses = np.column_stack([judged(case, _run(x, start)) - first for x in outputs[1:]]) if shifts else np.zeros((len(r), 0))
    counts = case.estimation | case.held_out
    felt = np.sqrt(np.mean(responses[counts] ** 2, axis=0)) > FELT * case.sigma
    if felt.any():
        chosen = [s for s, f in zip(shifts, felt, strict=True) if f]
        other = _refined(plant, case, start, first, responses[:, felt], chosen)
        if other is not None:
            return other
    return Run(y[:, 0], y[:, 1], start)


def _refined(
    plant: MujocoPlant, case: Case, start: Start, first: np.ndarray, responses: np.ndarray, shifts: list[tuple[str, float]]
) -> Run | None:
    """The run from the start that suits best, each number of it within its standard deviation; None where it is no better."""
    counts = case.estimation | case.held_out
    x, e = responses[counts] / case.sigma, (case.measured - first)[counts] / case.sigma
    shift = np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ e)
    moved = dataclasses.replace(start, **{n: getattr(start, n) + s * float(g) for (n, s), g in zip(shifts, shift, strict=True)})
    try:
        u, hold = case.drive()
        y = plant.run(u, case.recording.dt, start=moved, hold=hold)
    except DivergedError:
        return None
    after = (case.measured - judged(case, _run(y, start)))[counts] / case.sigma
    return Run(y[:, 0], y[:, 1], moved) if after @ after + shift @ shift < e @ e else None


def run_files(
    plants: Sequence[MujocoPlant], cases: Sequence[Case], threads: int, starts: Sequence[Start] | None = None
) -> list[list[Run | None]]:
    """``out[p][c]``: every file on every recording, side by side; ``starts``: of each recording, where they are known."""
    known: Sequence[Start | None] = starts or [None] * len(cases)
    with ThreadPoolExecutor(max(1, threads)) as pool:
        done = list(pool.map(lambda job: run_file(*job), [(p, c, s) for p in plants for c, s in zip(cases, known, strict=True)]))
    width = len(cases)
    return [done[i * width : (i + 1) * width] for i in range(len(plants))]


def run_surrogate(axis: Axis, case: Case, start: Start, *, locked: bool = True) -> Run | None:
    """The fitting engine's run on a recording; None where it diverges.

    ``locked``: position-locked laws follow the recorded angle, as in a fit; else the run's own, as in MuJoCo.
    """
    r, chain = case.recording, axis.chain
    ratios = np.array([chain.total_ratio(i) for i in range(len(chain.bodies))])
    initial = np.array([start.angle * ratios, start.velocity * ratios])
    try:
        angle = r.angle if locked and not case.servo else None
        y = simulate(axis, r.input, r.dt, initial=initial, angle=angle, before=start.input, hold=r.hold)
    except (DivergedError, ValueError):
        return None
    return Run(np.array(y.velocity), np.array(y.angle), start)


def error(case: Case, run: Run) -> np.ndarray:
    """Measured less predicted signal (N,)."""
    return np.asarray(case.measured - judged(case, run))


def chi_square(cases: Sequence[Case], runs: Sequence[Run | None], part: str = "estimation") -> tuple[float, int]:
    """Sum of squared errors over the noise variance, and the number of samples; infinite where a run diverged."""
    total, n = 0.0, 0
    for case, run in zip(cases, runs, strict=True):
        keep = getattr(case, part)
        n += int(keep.sum())
        if keep.any():
            total += math.inf if run is None else float(np.sum((error(case, run)[keep] / case.sigma) ** 2))
    return total, n


def at_noise(cases: Sequence[Case], runs: Sequence[Run | None]) -> bool:
    """Whether the mean squared error of both kinds of data is that of the noise, as far as this is known."""
    for part in ("estimation", "held_out"):
        chi2, n = chi_square(cases, runs, part)
        if n and not chi2 / n <= 1.0 + KNOWN + CLEAR * math.sqrt(2.0 / n):
            return False
    return True


def figures(cases: Sequence[Case], runs: Sequence[Run | None]) -> FitFigures:
    """Rms and nrmse on estimation and held-out data; infinite where a run diverged."""
    values: list[float] = []
    for part in ("estimation", "held_out"):
        squares = spread = 0.0
        n = 0
        for case, run in zip(cases, runs, strict=True):
            keep = getattr(case, part)
            if not keep.any():
                continue
            m = case.measured[keep]
            squares += math.inf if run is None else float(np.sum(error(case, run)[keep] ** 2))
            spread += float(np.sum((m - m.mean()) ** 2))
            n += len(m)
        values += [math.sqrt(squares / n), math.sqrt(squares / spread)] if n else [math.nan, math.nan]
    return FitFigures(values[0], values[1], values[2], values[3])
