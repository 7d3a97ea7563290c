"""The user's simulator as the judge: a model file, stepped by plain MuJoCo with its own options, beside the recordings.

A free run starts where the recording does: at its first angle, corrected by what its noise allows, and at rest or at the speed
that the first samples tell, corrected as the whole recording asks; a chain that starts in motion has deflections as well.
Errors are those of the measured velocity (the rate of the angle where no velocity was recorded), or of the measured angle where
a servo follows a command.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.data.derived import without_derived_velocity
from diagnose.data.experiment import (
    angle_noise_level,
    fewest_of,
    first_angle,
    hold_out_blocks,
    measured_velocity,
    prepare,
    resting_angle,
    smooth_velocity,
    with_common_noise,
)
from diagnose.data.noise import channel_noise
from diagnose.result import FitFigures
from diagnose.thresholds import SIGMAS, SMALL, TWICE
from mjsim.plant import Hold, Start
from mjsim.recording import Recording
from mjsim.signals import plain_step

__all__ = [
    "Case",
    "Run",
    "at_noise",
    "beyond",
    "cases_of",
    "chi_square",
    "error",
    "figures",
    "judged",
    "noise_level",
]

FIRST = 0.005  # [s] over which the speed at the first sample is a straight line, at least two samples


@dataclass(frozen=True, eq=False)
class Case:
    """A recording to be judged: which of its N samples belong to the estimation and to the held-out data, and its noise.

    measured (N,): the judged velocity, or the angle of a servo; sigma: its noise rms; moving: whether the axis moves at the
    first sample. unshown: numbers of the model, by name, that the recordings cannot tell and that stay as given in a fit
    (`diagnose.data.servo`).
    """

    recording: Recording
    measured: np.ndarray
    sigma: float
    moving: bool
    estimation: np.ndarray
    held_out: np.ndarray
    unshown: tuple[str, ...] = ()

    def start(self) -> Start:
        """Where the recording starts, by its first samples."""
        r = self.recording
        angle = float(r.angle[0]) if r.angle is not None else 0.0
        if not self.moving or not self.servo:
            angle, _ = (first_angle if self.moving else resting_angle)(r)
        if self.servo:
            return Start(angle, float(smooth_velocity(r)[0]) if self.moving else 0.0, float(r.input[0]))
        before = float(r.input[0]) if self.moving or r.command is not None else 0.0
        if not self.moving:
            return Start(angle, 0.0, before)
        if r.velocity is None:
            return Start(angle, float(smooth_velocity(r)[0]), before)
        few = max(2, min(len(r), round(FIRST / r.dt)))
        speed = float(np.polynomial.Polynomial.fit(np.arange(few), self.measured[:few], 1)(0.0))
        return Start(angle, speed, before)

    def spread(self) -> tuple[float, float]:
        """Standard deviations of the starting angle and velocity; 0 of one that is known.

        A measured velocity is late by its filter, so that the first one is known to the noise and to a small part of the speed.
        That by the angle alone, of a servo, is known to be one of the motion, which has its rms.
        """
        q = self.recording.angle
        angle = 0.0 if q is None else max(channel_noise(self.recording, "angle"), plain_step(q) / math.sqrt(12.0))
        if not self.moving or not self.servo:
            _, angle = (first_angle if self.moving else resting_angle)(self.recording)
        if self.servo:
            return angle, float(np.sqrt(np.mean(smooth_velocity(self.recording) ** 2))) if self.moving else 0.0
        speed = SMALL * float(np.sqrt(np.mean(self.measured**2)))
        return angle, math.hypot(self.sigma, speed) if self.moving else 0.0

    def first(self, n: int) -> Case:
        """The first n samples."""
        if n >= len(self.measured):
            return self
        cut = (a[:n] for a in (self.measured, self.estimation, self.held_out))
        measured, estimation, held_out = cut
        return replace(self, recording=self.recording.slice(0, n), measured=measured, estimation=estimation, held_out=held_out)

    @property
    def servo(self) -> bool:
        """Whether the input is the command of a servo, and its angle is judged."""
        return self.recording.command is not None and self.recording.angle is not None

    def drive(self) -> tuple[np.ndarray, Hold]:
        """Input (N, 1) of a plant, and how it goes between samples."""
        return self.recording.input[:, None], Hold(self.recording.hold)


@dataclass(frozen=True, eq=False)
class Run:
    """A free run of one case, or the first n of its samples: velocity and angle (n,), and where it started."""

    velocity: np.ndarray
    angle: np.ndarray
    start: Start


def cases_of(recordings: Sequence[Recording], held_out: Sequence[Recording], minimum: int | None = None) -> tuple[Case, ...]:
    """Every recording once, split as the diagnosis splits them: by recording, else by blocks.

    ``minimum``: measured samples of each, by default as many as a diagnosis needs. Raises InputError for one that cannot be used.
    """
    least = fewest_of(recordings) if minimum is None else minimum
    every = [without_derived_velocity(r) for r in (*recordings, *held_out)]
    out = []
    for i, (r, e) in enumerate(zip(every, with_common_noise([prepare(r, minimum=least) for r in every]), strict=True)):
        mine, other = (e.counts, np.zeros(len(r), bool))
        if not held_out:
            mine, other = (e.counts & part for part in hold_out_blocks(r))
        elif i >= len(recordings):
            mine, other = other, mine
        measured = measured_velocity(r) if r.command is None or r.angle is None else r.angle
        out.append(Case(r, measured, e.sigma, e.moving, mine, other))
    return tuple(out)


def judged(case: Case, run: Run) -> np.ndarray:
    """What of a run (N,) is compared with what was measured."""
    if case.servo:
        return run.angle
    return run.velocity if case.recording.velocity is not None else np.gradient(run.angle, case.recording.dt)


def error(case: Case, run: Run) -> np.ndarray:
    """Measured less predicted signal, for the samples (n,) that the run has: a part of a run has the first ones."""
    y = judged(case, run)
    return np.asarray(case.measured[: len(y)] - y)


def chi_square(cases: Sequence[Case], runs: Sequence[Run | None], part: str = "estimation") -> tuple[float, int]:
    """Sum of squared errors over the noise variance, and the number of samples; infinite where a run diverged."""
    total, n = 0.0, 0
    for case, run in zip(cases, runs, strict=True):
        keep = getattr(case, part)
        if run is not None:
            e = error(case, run)
            keep = keep[: len(e)]
            total += float(np.sum((e[keep] / case.sigma) ** 2))
        elif keep.any():
            total = math.inf
        n += int(keep.sum())
    return total, n


def noise_level(n: int) -> float:
    """Largest chi-square of n samples of noise, as far as its variance is known."""
    return n * (1.0 + SMALL) + SIGMAS * math.sqrt(2.0 * n)


def at_noise(cases: Sequence[Case], runs: Sequence[Run | None], *, angles: bool = False) -> bool:
    """Whether the mean squared error of both kinds of data is that of the noise, as far as this is known.

    angles: where the rate of an angle is judged, the angle itself must agree as well, to `TWICE` its noise.
    """
    sums = [chi_square(cases, runs, part) for part in ("estimation", "held_out")]
    return all(chi2 <= noise_level(n) for chi2, n in sums) and not (angles and any(map(_angle_differs, cases, runs)))


def _angle_differs(case: Case, run: Run | None) -> bool:
    """Whether the angle of a case without a velocity shows more than noise, which the noise of its rate may hide."""
    q, keep = case.recording.angle, case.estimation | case.held_out
    if run is None or q is None or case.servo or case.recording.velocity is not None or not keep.any():
        return False
    e = (q - run.angle)[keep]
    return float(np.std(e)) > TWICE * max(angle_noise_level(q), channel_noise(case.recording, "angle"))


def beyond(cases: Sequence[Case], runs: Sequence[Run | None], goal: float, part: str = "estimation") -> bool:
    """Whether chi-square is to exceed ``goal`` even where the samples that runs do not have yet leave noise alone."""
    chi2, n = chi_square(cases, runs, part)
    rest = sum(int(getattr(c, part).sum()) for c in cases) - n
    return chi2 + (1.0 - SMALL) * rest - SIGMAS * math.sqrt(2.0 * rest) > goal


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
