"""corrected.xml written in a form that MuJoCo steps as found, and judged by plain MuJoCo beside the file as given."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from diagnose.options import Options
from diagnose.result import Diagnosis, Finding, Verdict
from diagnose.thresholds import ALPHA
from diagnose.verdict import numerics
from diagnose.verdict.reference import Case, Run, at_noise, chi_square, figures, judged
from diagnose.verdict.reference_fit import refit_in_simulator
from diagnose.verdict.reference_runs import run_watched, too_far, work_of
from diagnose.verdict.reference_stage import APART, Nominal, compare_nominal
from diagnose.verdict.reference_start import run_surrogate
from diagnose.verdict.reference_verdict import MISSES, Files, by_simulator, gains_little, no_better, nominal_stands
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mjcf.adjust import adjust
from mjsim.mjcf.faithful import (
    AUTHOR,
    Faithful,
    as_plain,
    has_dry_friction,
    write_as_author,
    write_faithful,
)
from mjsim.plant import ChainPlant, MujocoPlant
from mjsim.plant.settings import altered, mended
from mjsim.recording import Recording
from simgap.bench import Bench
from simgap.file_numbers import with_numbers_of_file, without_short_times
from simgap.found import effect_found
from simgap.nearest_form import with_nearest
from simgap.plain_friction import plainer_friction, refit_to_noise
from simgap.sensitivity import is_sensitive, refitted_with_starts
from simgap.weakest_effect import without_weakest

__all__ = ["before_search", "write_judged"]

POLISHED = 1.02  # times the error that the engine reports, beyond which the numbers of a file are refitted in MuJoCo
BEGINNING = 1 / 8  # of the recordings, after which a form may be given up, and by which forms are ranked
MOST_FORM = 6e6  # of one run of all recordings (`work_of`), some 4 s: forms that need more are not tried


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
    bench = Bench(model, given, axis, result, nominal, out, threads)
    fewer = _without_creep(bench, cause) or plainer_friction(model, given, result, nominal, out, threads)
    soft = fewer is None and (cause is None or nominal.simulator) and not _explains(bench)
    if soft:  # no form of it is to be at the noise where the equations are not: the simulator's own friction first
        fewer = plainer_friction(model, given, result, nominal, out, threads, itself=True)
    if fewer is not None:
        result, form, runs = fewer
    elif cause is not None and not nominal.simulator:
        form, runs, found = _mended_alone(bench, cause) or _author_or_mended(bench, cause)
    else:
        form, runs = _polished(bench, *_write(bench, out))
    if fewer is None and not found and not at_noise(nominal.cases, runs):
        trial = out.with_name(f".{out.stem}.plain.part.xml")
        if not soft:
            fewer = plainer_friction(model, given, result, nominal, trial, threads, itself=True)
        if fewer is None:
            form, runs = _soft_or_not(bench, form, runs)
        else:
            trial.replace(out)
            result, form, runs = fewer
        trial.unlink(missing_ok=True)
    instead: tuple[str, ...] = ()
    if fewer is None and not found:
        form, runs, instead = with_nearest(bench, form, runs, _settled)
    less = None if found or fewer is not None else without_weakest(given, axis, result, nominal, form, runs, out, threads)
    if less is not None:
        result, axis, runs = less
    runs, stands = _or_as_given(bench, None if fewer else axis, result, form, runs, found)
    if stands:
        write_corrected(model, given, out)
        return by_simulator(result, nominal, Files(nominal.runs, (), "as given", notes=_told(cause, nominal), stands=True))
    runs, sensitive = _follows(bench, axis, form, runs)
    notes = () if found else (*_told(cause, nominal), *instead, *_refitted(axis, out))
    result = with_numbers_of_file(result, out, nominal.cases, runs, other=bool(found or form.lacks))
    result = without_short_times(result, given, nominal.cases)
    files = Files(runs, form.lacks, form.form, found, notes, sensitive, fewer is not None or less is not None)
    return by_simulator(result, nominal, files)


def _follows(bench: Bench, axis: Axis, form: Faithful, runs: Sequence[Run | None]) -> tuple[Sequence[Run | None], bool]:
    """Runs of the file, and whether its motion cannot be followed.

    A file that misses the engine's error is refitted with its starts, unless the smallest change leads elsewhere.
    """
    if form.lacks or not _misses(bench.result, bench.nominal.cases, runs, MISSES):
        return runs, False
    if is_sensitive(bench, bench.out, runs):
        return runs, True
    return refitted_with_starts(bench, axis, form, runs) or runs, False


def _or_as_given(
    bench: Bench, axis: Axis | None, result: Diagnosis, form: Faithful, runs: Sequence[Run | None], found: Sequence[Finding]
) -> tuple[Sequence[Run | None], bool]:
    """Runs of the file, and whether the one as given follows the recordings as well.

    The numbers of a file that gains little are refitted in MuJoCo before that is said; axis: None where they are already.
    """
    nominal = bench.nominal
    if found or form.lacks or not gains_little(result, nominal, runs):
        return runs, no_better(result, nominal, runs)
    if axis is not None:
        runs = _lowered(bench, axis, form, runs)
    return runs, gains_little(result, nominal, runs)


def _lowered(bench: Bench, axis: Axis, form: Faithful, runs: Sequence[Run | None]) -> Sequence[Run | None]:
    """Runs of the file with its numbers refitted in MuJoCo, where that lowers chi-square; else those that there are."""
    before, _ = chi_square(bench.nominal.cases, runs)
    better = bench.refit(axis, form.write, runs, before)
    if better is None or not better.chi2 < before:
        return runs
    form.write(better.axis, bench.out)
    return bench.run(bench.out)


def _explains(bench: Bench) -> bool:
    """Whether the equations leave noise alone, run as freely as MuJoCo runs a file."""
    nominal = bench.nominal
    if nominal.simulator:  # then the search compared with the simulator's difference taken out
        return True
    runs = [run_surrogate(bench.axis, c, s, locked=False) for c, s in zip(nominal.cases, bench.starts, strict=True)]
    return at_noise(nominal.cases, runs)


def _settled(bench: Bench) -> tuple[Faithful, Sequence[Run | None]]:
    """The form of a file that is nearest to its axis, its numbers refitted in MuJoCo, and its runs."""
    return _soft_or_not(bench, *_polished(bench, *_write(bench, bench.out)))


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


def _polished(bench: Bench, form: Faithful, runs: Sequence[Run | None]) -> tuple[Faithful, Sequence[Run | None]]:
    """The form that was written and its runs; refitted in MuJoCo where it misses the engine's error: a free run asks more."""
    nominal, result = bench.nominal, bench.result
    if form.lacks or not _misses(result, nominal.cases, runs, POLISHED):  # numbers would stand in for what the file lacks
        return form, runs
    return form, _lowered(bench, bench.axis, form, runs)


def _write(bench: Bench, out: Path) -> tuple[Faithful, Sequence[Run | None]]:
    """The form of the file that is nearest to what the search had in mind, and its runs."""
    nominal, axis, starts = bench.nominal, bench.axis, bench.starts
    cases, targets, done = nominal.cases, list[np.ndarray](), dict[bytes, Sequence[Run | None]]()
    tolerance = max([0.0, *(e.tolerance for e in axis.effects)])
    size = max(float(np.sqrt(np.mean(c.measured**2))) / c.sigma for c in cases)
    allowed = max(APART, tolerance * size)

    def differs(path: Path) -> tuple[float, bool]:
        if not targets:  # no form has what MJCF lacks
            carried = load_model(path, bound={}).carried
            targets.extend(_targets(bench, as_plain(axis, {key for key, _ in carried.lacks} if carried else ())))
        plant = MujocoPlant.load(path)
        if work_of(plant, cases) > MOST_FORM:
            return math.inf, False
        useless = too_far(cases, targets, allowed)
        begun = [math.ceil(BEGINNING * len(t)) for t in targets]
        runs, whole = run_watched(plant, cases, starts, bench.threads, lambda so_far: useless(so_far) and _beyond(so_far, begun))
        if not _beyond(runs, begun):  # it diverged
            return math.inf, False
        if whole and not useless(runs):
            done[path.read_bytes()] = runs
            return _apart(cases, runs, targets, [len(t) for t in targets]), True
        return _apart(cases, runs, targets, begun), False

    form = write_faithful(bench.model, axis, out, differs)
    runs = done.get(out.read_bytes())
    return form, bench.run(out) if runs is None else runs


def _targets(bench: Bench, axis: Axis) -> list[np.ndarray]:
    """What a file is to do (N,) on each recording: the equations, and the difference of the engines that the search left out."""
    nominal, out = bench.nominal, []
    for i, (case, start) in enumerate(zip(nominal.cases, bench.starts, strict=True)):
        run = run_surrogate(axis, case, start, locked=nominal.simulator)  # then the shifts are of runs along the recorded angle
        if run is None:
            out.append(np.full(len(case.measured), np.inf))
        else:
            out.append(judged(case, run) - (nominal.shifts[i] if nominal.simulator else 0.0))
    return out


def _beyond(runs: Sequence[Run], ends: Sequence[int]) -> bool:
    return all(len(r.angle) >= end for r, end in zip(runs, ends, strict=True))


def _apart(cases: Sequence[Case], runs: Sequence[Run], targets: Sequence[np.ndarray], ends: Sequence[int]) -> float:
    """Largest rms difference of runs from their targets over the noise, up to a sample of each recording."""
    rms = (np.sqrt(np.mean((judged(c, r)[:n] - t[:n]) ** 2)) for c, r, t, n in zip(cases, runs, targets, ends, strict=True))
    return max(float(x) / c.sigma for x, c in zip(rms, cases, strict=True))


def _without_creep(bench: Bench, cause: numerics.Cause | None) -> tuple[Diagnosis, Faithful, Sequence[Run | None]] | None:
    """The diagnosis without laws of friction that were found beside the file's own, where MuJoCo's soft friction does as well.

    A search by the equations takes the creep of the simulator's friction for presliding. None where it is not at the noise.
    """
    result, nominal, out = bench.result, bench.nominal, bench.out
    friction = [f for f in result.findings if f.kind == "physics" and effect_class(f.law).family == "friction"]
    if cause is None or cause.setting.id != "soft_friction" or nominal.simulator or not friction:
        return None
    others = [f for f in result.findings if f not in friction]
    values = {k: v.value for k, v in result.linear_parameters.items()}
    axis = bench.given.with_values(values).with_effects([effect_found(f) for f in others])
    write = partial(write_as_author, bench.model)
    try:
        refitted = refit_to_noise(axis, write, nominal.cases, out, bench.threads)
    except InputError:
        return None
    if refitted is None:
        return None
    _, lacks, runs = refitted
    return dataclasses.replace(result, findings=tuple(others)), Faithful(AUTHOR, math.nan, lacks, write), runs


def _soft_or_not(bench: Bench, form: Faithful, runs: Sequence[Run | None]) -> tuple[Faithful, Sequence[Run | None]]:
    """The file with dry friction as its author's settings (MuJoCo's own where there are none) have it, where that follows better.

    A recording of a simulator bears its soft friction, which the equations do not have.
    """
    axis, cases, out = bench.axis, bench.nominal.cases, bench.out
    if not has_dry_friction(axis) or form.form == AUTHOR or form.lacks:  # numbers would stand in for what the file lacks
        return form, runs
    trial = out.with_name(f".{out.stem}.author.part.xml")
    write = partial(write_as_author, bench.model)
    goal = chi_square(cases, runs)[0] / MISSES**2
    try:
        better = refit_in_simulator(axis, write, out.name, cases, bench.starts, bench.threads, goal)
        if better is None or not better.chi2 < goal:
            return form, runs
        lacks = write(better.axis, trial)
        after = bench.run(trial)
        gain, p = numerics.gain_of(cases, runs, after)
        if not (gain > 0 and p < ALPHA):
            return form, runs
        trial.replace(out)
        return Faithful(AUTHOR, math.nan, lacks, write), after
    finally:
        trial.unlink(missing_ok=True)


def _mended_alone(bench: Bench, cause: numerics.Cause) -> tuple[Faithful, Sequence[Run | None], tuple[Finding, ...]] | None:
    """The file as given with its setting mended, where its numbers stand by the equations and that alone leaves noise.

    None where it does not: then numbers may stand in for the setting.
    """
    nominal, out = bench.nominal, bench.out
    if bench.result.verdict is not Verdict.NO_MISMATCH or at_noise(nominal.cases, nominal.runs):
        return None

    def write(axis: Axis, path: Path) -> tuple[str, ...]:
        lacks = write_as_author(bench.model, axis, path)
        change = mended(MujocoPlant.load(path).model, cause.setting.id)
        if change is not None:
            adjust(path, change[1], f"Mended: {cause.setting.sentence}")
        return lacks

    try:
        lacks = write(bench.given, out)
    except InputError:  # elements without names: the setting cannot be written
        return None
    runs = bench.run(out)
    gain, p = numerics.gain_of(nominal.cases, nominal.runs, runs)
    if not (gain > 0 and p < ALPHA and at_noise(nominal.cases, runs)):
        return None
    before, after = (figures(nominal.cases, r).held_out_rms for r in (nominal.runs, runs))
    form = Faithful(f"{cause.setting.id.replace('_', ' ')} mended", math.nan, lacks, write)
    return form, runs, (numerics.finding(cause, "motor", before, after, p),)


def _author_or_mended(bench: Bench, cause: numerics.Cause) -> tuple[Faithful, Sequence[Run | None], tuple[Finding, ...]]:
    """The file with its author's settings; mended where only that follows the recordings, and held-out data better for sure."""
    result, nominal, out, write = bench.result, bench.nominal, bench.out, partial(write_as_author, bench.model)
    form, runs = Faithful(AUTHOR, math.nan, write(bench.axis, out), write), bench.run(out)
    form, runs = _polished(bench, form, runs)
    if not _misses(result, nominal.cases, runs, MISSES):
        return form, runs, ()
    trial = out.with_name(f".{out.stem}.mended.part.xml")
    try:
        other, better = _write(bench, trial)
        model = MujocoPlant.load(trial).model
        changed = altered(MujocoPlant.load(out).model, model, cause.setting.id)
        gain, p = numerics.gain_of(nominal.cases, runs, better)
        fits = chi_square(nominal.cases, better)[0] <= chi_square(nominal.cases, runs)[0]  # of refitted numbers as well
        if not changed and gain > 0 and p < ALPHA and fits:  # another setting does
            trial.replace(out)
            return other, better, ()
        change = mended(model, cause.setting.id)
        if change is not None and (not changed or _misses(result, nominal.cases, better, MISSES)):
            adjust(trial, change[1])
            better = bench.run(trial)
        gain, p = numerics.gain_of(nominal.cases, runs, better)
        if not (gain > 0 and p < ALPHA) or _misses(result, nominal.cases, better, MISSES):
            return form, runs, ()
        trial.replace(out)
        before, after = (figures(nominal.cases, r).held_out_rms for r in (runs, better))
        return other, better, (numerics.finding(cause, "motor", before, after, p),)
    except InputError:  # elements without names: the setting cannot be written
        return form, runs, ()
    finally:
        trial.unlink(missing_ok=True)
