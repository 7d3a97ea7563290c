"""Before the search: whether engine and simulator differ on the nominal model, and which of the two the recordings bear.

Where they differ by more than a fifth of the noise, the nominal structure is refitted by both. Where the recordings bear the
simulator's numerics (they were made with it, say), and it comes near the noise with these or leaves half the squared error that
it leaves by the engine, the difference of the two runs is taken out of what the search compares. That is then the user's
simulator beside the recording, to first order in what the search changes,

    y - [S(theta) + M(theta_0) - S(theta_0)],    M: the file in MuJoCo, S: the engine, theta_0: the nominal structure, refitted.

Source of the correction: M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425; space mapping, J. W. Bandler et al. 1994.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from diagnose.data.servo import as_servo
from diagnose.result import Diagnosis, Traces
from diagnose.thresholds import FAR, TWICE, UNEXPLAINED
from diagnose.verdict.reference import Case, Run, at_noise, cases_of, chi_square, error, judged
from diagnose.verdict.reference_fit import Refit, refit_in_engine, refit_in_simulator
from diagnose.verdict.reference_runs import run_files
from diagnose.verdict.reference_start import run_surrogate
from mjsim.axis import Axis
from mjsim.chain import Limit
from mjsim.mjcf import load_model
from mjsim.mjcf.faithful import write_as_author
from mjsim.mjcf.joint_limit import limit_of, with_limit
from mjsim.mjcf.softness import has_soft_friction, with_softness
from mjsim.plant import MujocoPlant, Start
from mjsim.recording import Recording

__all__ = ["APART", "Nominal", "apart", "by_other_friction", "by_other_numerics", "compare_nominal", "without_difference"]

NEAR = 0.1  # of the travel: farther from a limit, a model that follows the recording to a tenth does not touch it
APART = math.sqrt(UNEXPLAINED - 1)  # of the noise rms: a difference that adds so much to its variance


@dataclass(frozen=True, eq=False)
class Nominal:
    """The nominal file on the recordings, in MuJoCo and in the fitting engine.

    axis: of the file, with dry friction that is soft as in MuJoCo where that fits the recordings better, or, of a file without
    dry friction, where these show the simulator's numerics; other: with the other kind of friction, None where MuJoCo holds a
    joint at rest; soft: how far the softness moves the file's run, over the noise.
    runs, engine: of each case, both free; apart: rms difference of the two over the noise, the largest of the recordings;
    simulator: whether the recordings bear the simulator's numerics rather than the engine's: the refitted nominal structure
    does with them, and comes near the noise or leaves half as much; shifts: to add to the velocity of each recording, also where
    that is open; beside: whether one effect beside the nominal structure is to leave half as much with the simulator's numerics.
    """

    path: Path
    axis: Axis
    other: Axis | None
    soft: float
    plant: MujocoPlant
    cases: tuple[Case, ...]
    runs: Sequence[Run | None]
    engine: Sequence[Run | None]
    apart: float
    simulator: bool = False
    refitted: Refit | None = None
    by_engine: Refit | None = None
    shifts: tuple[np.ndarray, ...] = ()
    beside: bool = False

    @property
    def shows_simulator(self) -> bool:
        """Whether the nominal structure, refitted, leaves half as much with the simulator's numerics, or does with one effect."""
        if self.beside:
            return True
        return bool(self.shifts and self.refitted and self.by_engine and TWICE * self.refitted.chi2 <= self.by_engine.chi2)

    def corrections(self) -> dict[str, np.ndarray]:
        """The shifts by the SHA-256 (else the source) of the recording."""
        if not self.simulator:
            return {}
        return {c.recording.sha256 or c.recording.source: s for c, s in zip(self.cases, self.shifts, strict=True)}


def compare_nominal(
    path: Path, axis: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], threads: int
) -> Nominal:
    """Run the nominal file in MuJoCo and in the engine, and settle whose numerics the recordings have. Raises InputError."""
    model = load_model(path)
    given, (axis, recordings, held_out, _) = axis, as_servo(axis, recordings, held_out)
    unshown = _unshown(given, axis)
    cases = tuple(dataclasses.replace(case, unshown=unshown) for case in cases_of(recordings, held_out))
    plant = MujocoPlant.load(path)
    runs = run_files([plant], cases, threads)[0]
    limit = limit_of(model)
    if limit is not None and any(_reaches(limit, case, run) for case, run in zip(cases, runs, strict=True)):
        given = with_limit(given, model)
        axis = as_servo(given, recordings, held_out)[0]
    starts = [case.start() if run is None else run.start for case, run in zip(cases, runs, strict=True)]
    engine = [run_surrogate(axis, case, start, locked=False) for case, start in zip(cases, starts, strict=True)]
    softer = with_softness(given, model)
    other, softness = (None, 0.0) if softer.chain == given.chain else (softer, 0.0)
    if other is not None and has_soft_friction(model):
        soft = as_servo(softer, recordings, held_out)[0]
        creeping = [run_surrogate(soft, case, start, locked=False) for case, start in zip(cases, starts, strict=True)]
        softness = apart(cases, creeping, engine)
        if softness > 0 and _soft_fits(soft, axis, cases, starts):
            given, other, axis, engine = softer, given, soft, creeping
    nominal = Nominal(path, given, other, softness, plant, cases, runs, engine, apart(cases, runs, engine))
    if not APART < nominal.apart < math.inf:
        return nominal
    by_engine = refit_in_engine(axis, cases, starts)
    as_it_is, _ = chi_square(cases, runs)
    if by_engine is None or (at_noise(cases, by_engine.runs) and by_engine.chi2 < as_it_is):
        return dataclasses.replace(nominal, by_engine=by_engine)
    write = partial(write_as_author, path)
    refitted: Refit | None = Refit({}, axis, runs, as_it_is)
    if as_it_is > by_engine.chi2:
        refitted = refit_in_simulator(by_engine.axis, write, path.name, cases, starts, threads, by_engine.chi2, own_slopes=False)
        if refitted is None or refitted.chi2 > by_engine.chi2:
            return dataclasses.replace(nominal, by_engine=by_engine)
        with tempfile.TemporaryDirectory() as work:
            write(refitted.axis, Path(work) / path.name)
            own = run_files([MujocoPlant.load(Path(work) / path.name)], cases, threads, starts)[0]
        refitted = dataclasses.replace(refitted, runs=own)
    assert refitted is not None
    # along the angle of MuJoCo's run: what differs then is the numerics, and not what the structure misses of the angle
    same = [
        None if run is None else run_surrogate(refitted.axis, case, start, along=run.angle)
        for case, start, run in zip(cases, starts, refitted.runs, strict=True)
    ]
    shifts = _shifts(cases, refitted.runs, same)
    near = refitted.chi2 <= FAR * chi_square(cases, refitted.runs)[1]
    found = dataclasses.replace(nominal, by_engine=by_engine, refitted=refitted, shifts=shifts)
    if found.shows_simulator:
        return by_other_numerics(found)
    return dataclasses.replace(found, simulator=bool(shifts) and near)


def _unshown(given: Axis, axis: Axis) -> tuple[str, ...]:
    """The numbers that ``axis`` holds, fewer those that it holds at another value than the file as ``given``: a known gain."""
    before = {p.name: p.value for p in given.chain.linear_parameters()}
    freed = dataclasses.replace(axis.chain, held=given.chain.held).linear_parameters()
    other = {p.name for p in freed if p.name in before and not math.isclose(p.value, before[p.name], rel_tol=1e-9)}
    return tuple(name for name in axis.chain.held if name not in other)


def _reaches(limit: Limit, case: Case, run: Run | None) -> bool:
    """Whether a recording, or the file's run beside it, comes as near to a limit as a tenth of its travel."""
    r = case.recording
    angle = r.angle if r.angle is not None else np.cumsum(case.measured) * r.dt
    for q in (angle,) if run is None else (angle, run.angle):
        near = NEAR * float(np.ptp(q))
        if np.max(q) > limit.upper - near or np.min(q) < limit.lower + near:
            return True
    return False


def by_other_numerics(nominal: Nominal) -> Nominal:
    """The nominal file with the simulator's numerics taken out, or left in where they were not.

    Dry friction that a file lacks is taken to be the simulator's where these are, and to hold at rest where they are not.
    """
    change = dataclasses.replace(nominal, simulator=not nominal.simulator)
    if nominal.other is None or any(e.family == "friction" for e in nominal.axis.effects):
        return change
    if any(b.softness for b in nominal.axis.chain.bodies) == change.simulator:
        return change
    return dataclasses.replace(change, axis=nominal.other, other=nominal.axis)


def by_other_friction(nominal: Nominal) -> Nominal:
    """The nominal file beside equations with the other kind of dry friction; MuJoCo's own numerics are not taken out."""
    if nominal.other is None:
        raise ValueError("the file has one kind of dry friction")
    starts = [case.start() if run is None else run.start for case, run in zip(nominal.cases, nominal.runs, strict=True)]
    axis = as_servo(nominal.other, [c.recording for c in nominal.cases], [])[0]
    engine = [run_surrogate(axis, case, start, locked=False) for case, start in zip(nominal.cases, starts, strict=True)]
    return dataclasses.replace(
        nominal, axis=nominal.other, other=None, engine=engine, apart=apart(nominal.cases, nominal.runs, engine),
        simulator=False, refitted=None, by_engine=None, shifts=(), beside=False,
    )  # fmt: skip


def _soft_fits(soft: Axis, hard: Axis, cases: Sequence[Case], starts: Sequence[Start]) -> bool:
    """Whether soft friction fits the recordings as well as one that holds at rest, the nominal numbers refitted with both."""
    fits = [refit_in_engine(axis, cases, starts) for axis in (soft, hard)]
    chi2 = [math.inf if f is None else f.chi2 for f in fits]
    return chi2[0] < math.inf and chi2[0] <= chi2[1]


def apart(cases: Sequence[Case], runs: Sequence[Run | None], others: Sequence[Run | None]) -> float:
    """Largest rms difference of two models over the noise; infinite where one diverged."""
    out = 0.0
    for case, a, b in zip(cases, runs, others, strict=True):
        if a is None or b is None:
            return math.inf
        out = max(out, float(np.sqrt(np.mean((judged(case, a) - judged(case, b)) ** 2))) / case.sigma)
    return out


def _shifts(cases: Sequence[Case], runs: Sequence[Run | None], engine: Sequence[Run | None]) -> tuple[np.ndarray, ...]:
    if any(r is None for r in (*runs, *engine)):
        return ()
    return tuple(
        error(c, a) - error(c, b) for c, a, b in zip(cases, runs, engine, strict=True) if a is not None and b is not None
    )


def without_difference(result: Diagnosis, nominal: Nominal) -> Diagnosis:
    """The diagnosis with its signals as they were recorded: the difference of the two engines is on the side of the models."""
    if not nominal.simulator:
        return result
    by_source = {c.recording.source: s for c, s in zip(nominal.cases, nominal.shifts, strict=True)}

    def back(t: Traces) -> Traces:
        shift = by_source.get(t.source)
        if shift is None or len(shift) != len(t.time):
            return t
        moved = {name: getattr(t, name) - shift for name in ("measured", "nominal", "refitted", "corrected", "mapped")
                 if getattr(t, name) is not None}  # fmt: skip
        return dataclasses.replace(t, **moved)

    return dataclasses.replace(result, traces=tuple(back(t) for t in result.traces))
