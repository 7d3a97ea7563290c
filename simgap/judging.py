"""corrected.xml written in a form that MuJoCo steps as found, and judged by plain MuJoCo beside the file as given."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from diagnose.options import Options
from diagnose.result import Diagnosis, Finding
from diagnose.verdict import numerics
from diagnose.verdict.reference import Case, Run, at_noise, chi_square, figures, judged, run_files, run_surrogate, work_of
from diagnose.verdict.reference_fit import MOST_WORK, refit_in_simulator
from diagnose.verdict.reference_stage import APART, Nominal, compare_nominal
from diagnose.verdict.reference_verdict import MISSES, Files, by_simulator, nominal_stands
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, write_corrected
from mjsim.mjcf.adjust import adjust
from mjsim.mjcf.faithful import AUTHOR, Faithful, has_dry_friction, write_as_author, write_faithful
from mjsim.plant import ChainPlant, MujocoPlant, Start
from mjsim.plant.settings import mended
from mjsim.recording import Recording
from simgap.plain_friction import plainer_friction

__all__ = ["before_search", "write_judged"]

POLISHED = 1.02  # times the error that the engine reports, beyond which the numbers of a file are refitted in MuJoCo
NUDGE = 1e-3  # of the noise of the angle, by which a start is moved to see whether a motion is sensitive
MOST_FORM = 6e6  # of one run of all recordings (`work_of`), some 4 s: forms that need more are not tried
SMALLEST = 1e-6  # of the travel, where no noise of the angle is known


def before_search(
    path: Path, axis: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options
) -> Nominal | None:
    """The nominal file in MuJoCo beside the engine; None where recordings are judged by force, or know a torque."""
    r = recordings[0]
    if any(x.known_torque is not None for x in (*recordings, *held_out)):
        return None
    if axis.chain.servo is not None:
        return compare_nominal(path, axis, recordings, held_out, options.jobs)
    judge = options.judge or r.judge or ("motion" if r.velocity is not None else "force")
    return None if judge == "force" else compare_nominal(path, axis, recordings, held_out, options.jobs)


def write_judged(
    model: Path, given: Axis, axis: Axis, result: Diagnosis, nominal: Nominal | None, out: Path, threads: int
) -> Diagnosis:
    """Write ``out`` for an axis that was found beside that of the file as ``given``.

    Returns the diagnosis, by MuJoCo's figures where it was judged by motion.
    """
    if nominal is None or result.channel == "torque" or not result.noise_floor > 0:
        write_corrected(model, axis, out)
        return result
    cause = numerics.cause_of(nominal, threads)
    if nominal_stands(result, nominal):
        write_corrected(model, given, out)
        return by_simulator(result, nominal, Files(nominal.runs, (), "as given", notes=_told(cause, nominal)))
    found: tuple[Finding, ...] = ()
    fewer = _without_creep(model, given, result, nominal, cause, out, threads)
    if fewer is None:
        fewer = plainer_friction(model, given, result, nominal, out, threads)
    if fewer is not None:
        result, form, runs = fewer
    elif cause is not None and not nominal.simulator:
        form, runs, found = _author_or_mended(model, axis, result, nominal, cause, out, threads)
    else:
        form = _write(model, axis, nominal, out, threads)
        runs = _polished(axis, form, result, nominal, out, threads)
    if fewer is None and not found and not at_noise(nominal.cases, runs):
        trial = out.with_name(f".{out.stem}.plain.part.xml")
        fewer = plainer_friction(model, given, result, nominal, trial, threads, itself=True)
        if fewer is None:
            form, runs = _soft_or_not(model, axis, form, nominal, out, runs, threads)
        else:
            trial.replace(out)
            result, form, runs = fewer
        trial.unlink(missing_ok=True)
    files = Files(
        runs, form.lacks, form.form, found, (*(() if found else _told(cause, nominal)), *_refitted(axis, out)),
        _sensitive(MujocoPlant.load(out), nominal.cases, runs), fewer is not None,
    )  # fmt: skip
    return by_simulator(result, nominal, files)


def _told(cause: numerics.Cause | None, nominal: Nominal) -> tuple[str, ...]:
    told = numerics.note(cause, nominal)
    return (told,) if told else ()


def _refitted(axis: Axis, out: Path) -> tuple[str, ...]:
    """A note on the numbers of the file that were refitted in MuJoCo, and are not those of the fit."""
    now = {p.name: p.value for p in ChainPlant(load_axis(out)).parameters}
    told = [
        f"{p.name} {p.value:.5g} -> {now[p.name]:.5g} {p.unit}"
        for p in ChainPlant(axis).parameters
        if p.name in now and not math.isclose(p.value, now[p.name], rel_tol=1e-6, abs_tol=1e-12)
    ]
    return (f"In corrected.xml these numbers are refitted in plain MuJoCo: {', '.join(told)}.",) if told else ()


def _misses(result: Diagnosis, cases: Sequence[Case], runs: Sequence[Run | None], times: float) -> bool:
    """Whether runs of a file err by more than ``times`` what the engine reports, on either kind of data."""
    own, engine = figures(cases, runs), result.fit["corrected"]
    return any(not a <= times * b for a, b in ((own.rms, engine.rms), (own.held_out_rms, engine.held_out_rms)) if b == b)


def _polished(axis: Axis, form: Faithful, result: Diagnosis, nominal: Nominal, out: Path, threads: int) -> Sequence[Run | None]:
    """Runs of the file; its numbers are refitted in MuJoCo where it misses the engine's error: a free run asks more of them."""
    runs: Sequence[Run | None] = run_files([MujocoPlant.load(out)], nominal.cases, threads, _starts(nominal))[0]
    if form.lacks or not _misses(result, nominal.cases, runs, POLISHED):  # numbers would stand in for what the file lacks
        return runs
    starts = [case.start() if run is None else run.start for case, run in zip(nominal.cases, runs, strict=True)]
    better = refit_in_simulator(axis, form.write, out.name, nominal.cases, starts, threads)
    if better is None or not better.chi2 < chi_square(nominal.cases, runs)[0]:
        return runs
    form.write(better.axis, out)
    return run_files([MujocoPlant.load(out)], nominal.cases, threads)[0]


def _starts(nominal: Nominal) -> list[Start]:
    return [case.start() if run is None else run.start for case, run in zip(nominal.cases, nominal.runs, strict=True)]


def _write(model: Path, axis: Axis, nominal: Nominal, out: Path, threads: int) -> Faithful:
    """The form of the file that is nearest to what the search had in mind."""
    starts = _starts(nominal)
    locked = nominal.simulator  # then the shifts are those of runs that follow the recorded angle
    wanted = [run_surrogate(axis, case, start, locked=locked) for case, start in zip(nominal.cases, starts, strict=True)]
    shifts = list(nominal.shifts) or [np.zeros(1)] * len(wanted)

    def differs(path: Path) -> float:
        plant = MujocoPlant.load(path)
        if work_of(plant, nominal.cases) > MOST_FORM:
            return math.inf
        runs = run_files([plant], nominal.cases, threads, starts)[0]
        most = 0.0
        for case, run, ideal, shift in zip(nominal.cases, runs, wanted, shifts, strict=True):
            if run is None or ideal is None:
                return math.inf
            most = max(most, float(np.sqrt(np.mean((judged(case, run) - judged(case, ideal) + shift) ** 2))) / case.sigma)
        return most

    tolerance = max([0.0, *(e.tolerance for e in axis.effects)])
    size = max(float(np.sqrt(np.mean(c.measured**2))) / c.sigma for c in nominal.cases)
    return write_faithful(model, axis, out, differs, max(APART, tolerance * size))


def _without_creep(
    model: Path, given: Axis, result: Diagnosis, nominal: Nominal, cause: numerics.Cause | None, out: Path, threads: int
) -> tuple[Diagnosis, Faithful, Sequence[Run | None]] | None:
    """The diagnosis without laws of friction that were found beside the file's own, where MuJoCo's soft friction does as well.

    A search by the equations takes the creep of the simulator's friction for presliding. None where it is not at the noise.
    """
    friction = [f for f in result.findings if f.kind == "physics" and effect_class(f.law).family == "friction"]
    if cause is None or cause.setting.id != "soft_friction" or nominal.simulator or not friction:
        return None
    others = [f for f in result.findings if f not in friction]
    values = {k: v.value for k, v in result.linear_parameters.items()}
    axis = given.with_values(values).with_effects(
        [effect_class(f.law)(place=f.place, **{k: v.value for k, v in f.parameters.items()}) for f in others]
    )
    try:
        lacks = write_as_author(model, axis, out)
    except InputError:
        return None
    runs: Sequence[Run | None] = run_files([MujocoPlant.load(out)], nominal.cases, threads)[0]
    starts = [case.start() if run is None else run.start for case, run in zip(nominal.cases, runs, strict=True)]
    write = partial(write_as_author, model)
    better = refit_in_simulator(axis, write, out.name, nominal.cases, starts, threads)
    if better is None:
        return None
    write(better.axis, out)
    runs = run_files([MujocoPlant.load(out)], nominal.cases, threads)[0]
    if not at_noise(nominal.cases, runs):
        return None
    return dataclasses.replace(result, findings=tuple(others)), Faithful(AUTHOR, math.nan, lacks, write), runs


def _soft_or_not(
    model: Path, axis: Axis, form: Faithful, nominal: Nominal, out: Path, runs: Sequence[Run | None], threads: int
) -> tuple[Faithful, Sequence[Run | None]]:
    """The file with dry friction as its author's settings (MuJoCo's own where there are none) have it, where that follows better.

    A recording of a simulator bears its soft friction, which the equations do not have.
    """
    if not has_dry_friction(axis) or form.form == AUTHOR:
        return form, runs
    trial = out.with_name(f".{out.stem}.author.part.xml")
    try:
        lacks = write_as_author(model, axis, trial)
        given = run_files([MujocoPlant.load(trial)], nominal.cases, threads)[0]
        starts = [case.start() if run is None else run.start for case, run in zip(nominal.cases, given, strict=True)]
        better = refit_in_simulator(axis, partial(write_as_author, model), out.name, nominal.cases, starts, threads)
        if better is None or not MISSES**2 * better.chi2 < chi_square(nominal.cases, runs)[0]:
            return form, runs
        write_as_author(model, better.axis, trial)
        after = run_files([MujocoPlant.load(trial)], nominal.cases, threads)[0]
        gain, p = numerics.gain_of(nominal.cases, runs, after)
        if not (gain > 0 and p < numerics.SURE):
            return form, runs
        trial.replace(out)
        return Faithful(AUTHOR, math.nan, lacks, partial(write_as_author, model)), after
    finally:
        trial.unlink(missing_ok=True)


def _author_or_mended(
    model: Path, axis: Axis, result: Diagnosis, nominal: Nominal, cause: numerics.Cause, out: Path, threads: int
) -> tuple[Faithful, Sequence[Run | None], tuple[Finding, ...]]:
    """The file with its author's settings; mended where only that follows the recordings, and held-out data better for sure."""
    form = Faithful(AUTHOR, math.nan, write_as_author(model, axis, out), partial(write_as_author, model))
    runs = _polished(axis, form, result, nominal, out, threads)
    if not _misses(result, nominal.cases, runs, MISSES):
        return form, runs, ()
    trial = out.with_name(f".{out.stem}.mended.part.xml")
    try:
        other = _write(model, axis, nominal, trial, threads)
        change = mended(MujocoPlant.load(trial).model, cause.setting.id)
        if change is not None:
            adjust(trial, change[1])
        better = run_files([MujocoPlant.load(trial)], nominal.cases, threads)[0]
        gain, p = numerics.gain_of(nominal.cases, runs, better)
        if not (gain > 0 and p < numerics.SURE) or _misses(result, nominal.cases, better, MISSES):
            return form, runs, ()
        trial.replace(out)
        before, after = (figures(nominal.cases, r).held_out_rms for r in (runs, better))
        return other, better, (numerics.finding(cause, "motor", before, after, p),)
    except InputError:  # elements without names: the setting cannot be written
        return form, runs, ()
    finally:
        trial.unlink(missing_ok=True)


def _sensitive(plant: MujocoPlant, cases: Sequence[Case], runs: Sequence[Run | None]) -> bool:
    """Whether a start that differs by a thousandth of the angle's noise leads to a motion a fifth of the noise away.

    Not asked of files that take more than `MOST_WORK`.
    """
    if work_of(plant, cases) > MOST_WORK:
        return False
    starts = []
    for case, run in zip(cases, runs, strict=True):
        if run is None:
            return False
        angle = NUDGE * case.spread()[0] or SMALLEST * float(np.ptp(run.angle))
        starts.append(dataclasses.replace(run.start, angle=run.start.angle + angle))
    others = run_files([plant], cases, 1, starts)[0]
    return any(
        a is None or b is None or float(np.sqrt(np.mean((judged(c, a) - judged(c, b)) ** 2))) > APART * c.sigma
        for a, b, c in zip(runs, others, cases, strict=True)
    )
