"""The whole flow: recording -> compare -> locate -> hypothesise -> fit -> validate -> decide -> result."""

from __future__ import annotations

import dataclasses
import math
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from diagnose.data.experiment import Experiment, corrected, held_rows, hold_out_blocks, prepare, without_derived_velocity
from diagnose.evidence.encoder import fit_beside_encoder
from diagnose.evidence.predictable import Structure, motion_error, motion_errors, remaining_structure
from diagnose.explain.ahead import k_step
from diagnose.explain.locate import locate
from diagnose.explain.second_encoder import judge_second_encoder
from diagnose.explain.torque_map import fit_map
from diagnose.fit.fit_cache import Memory
from diagnose.fit.fitted import UNEXPLAINED, Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit
from diagnose.fit.whiten import noise_rms
from diagnose.options import RUNS, Options
from diagnose.problem.view import ForceView, MotionView, View, clean_band, growth_when_held
from diagnose.progress import Progress, Step
from diagnose.result import Diagnosis, Finding, FitFigures, NominalEffect, Rival, Traces, Verdict
from diagnose.structure.moves import put_together
from diagnose.structure.passes import searched
from diagnose.structure.search import ALIKE_C, Search
from diagnose.verdict.calibration import false_alarm_rate
from diagnose.verdict.decide import (
    equivalents,
    estimates,
    next_experiment,
    p_values,
    unphysical,
)
from mjsim.axis import Axis
from mjsim.effects import Effect
from mjsim.errors import InputError
from mjsim.recording import Recording

__all__ = ["Options", "diagnose"]

Split = tuple[tuple[Experiment, ...], tuple[Experiment, ...]]

AGAIN = 1 / 3  # part of the simulations that a search of another split of the recordings may take whatever the first one took
JUDGED = 8  # rivals whose held-out error the report shows, whether the search has asked for it or not
SWING = 3.0  # log of the growth over a recording from which a mechanism cannot be moved as recorded
EVENTS = (30.0, 56.0, 100.0, 170.0)  # rates [1/s] at which a model is led whose free run goes astray
POWER = 20.0  # times the material error that the nominal model must leave there, for the test to mean something

SHOWN = 1.1  # of the noise rms, in the held-out error of a model that leaves none on what it was fitted to
SHARED = (
    "The estimation recordings fit without it: they hardly exercise what is missing, and the held-out ones do. So all recordings "
    "were fitted over two thirds of their length, in blocks, and judged on the rest. Record an estimation run that exercises it."
)

DERIVED = (
    "The velocity column is the difference of the angle column, sample by sample: it holds the angle's noise and nothing more, "
    "half a sample off. The angle alone is used."
)

HELD = (
    "The mismatch is no physics of the axis: rows of the recordings repeat the row before and were not measured; where they "
    "were, the nominal structure agrees to within the noise."
)


def choose_view(recordings: Sequence[Recording], judge: str | None, nominal: Axis | None = None) -> View:
    """Motion or force.

    As asked, as the binding says, else force when there is only a position (a servo under a position loop) and the mechanism
    behind the driven body can be moved as recorded: one that is unstable then swings up whatever the torque. Raises
    InputError where that is asked for.
    """
    judge = judge or recordings[0].judge
    growth = growth_when_held(nominal) if nominal is not None else -math.inf
    swings_up = growth * max(r.duration for r in recordings) > SWING
    if judge == "force" and swings_up:
        raise InputError(
            "judge", f"'force', and behind the driven body, once that is held, the nominal model swings up by {growth:.3g} 1/s",
            "'motion'", "judge by motion, or correct the damping of the nominal model",
        )  # fmt: skip
    if judge is None:
        judge = "force" if recordings[0].velocity is None and not swings_up else "motion"
    if judge == "motion":
        return MotionView() if nominal is None else MotionView.of(nominal, recordings)
    dt = recordings[0].dt
    decimate = max(1, round(0.01 / dt)) if dt < 0.005 else 1
    if nominal is None:
        return ForceView(decimate=decimate)
    return ForceView(cutoff_hz=min(clean_band(nominal, r) for r in recordings), decimate=decimate)


def _experiments(recordings: Sequence[Recording], held_out: Sequence[Recording]) -> Split:
    """Estimation and held-out experiments; blocks of the recordings where no other recording is given."""
    if held_out:
        used = {r.sha256: r.source for r in recordings if r.sha256}
        for r in held_out:
            if r.sha256 in used:
                raise InputError(
                    f"--held-out {r.source}", f"the same data as {used[r.sha256]}, which is fitted",
                    "a recording that is not fitted", "leave it out: blocks of the recordings are then held out",
                )  # fmt: skip
        return tuple(prepare(r) for r in recordings), tuple(prepare(r) for r in held_out)
    estimation, held = [], []
    for r in recordings:
        mine, other = hold_out_blocks(r)
        estimation.append(prepare(r, counts=mine))
        held.append(prepare(r, counts=other))
    return tuple(estimation), tuple(held)


def diagnose(
    nominal: Axis,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    options: Options | None = None,
    progress: Callable[[Step], None] = lambda _: None,
    memory: Memory | None = None,
    corrections: Mapping[str, np.ndarray] | None = None,
) -> Diagnosis:
    """Diagnose recordings of one axis against its nominal model.

    ``progress`` is told each `Step`; ``memory``: where fits are written down as they are found, and looked up before they are
    made. ``corrections`` (N,): added to the measured velocity where motion is compared, by the SHA-256 (else source) of
    a recording. Raises InputError for recordings that cannot be used or a nominal model that cannot be run on them.
    """
    options = options or Options()
    began = time.monotonic()
    given = recordings[0].velocity is not None
    recordings, held_out = ([without_derived_velocity(r) for r in group] for group in (recordings, held_out))
    derived = given and recordings[0].velocity is None
    view = choose_view(recordings, options.judge or recordings[0].judge or ("motion" if derived else None), nominal)
    varies = _varies(nominal, recordings[0])

    taken = 0

    def by(experiments: Split) -> Diagnosis:
        nonlocal taken
        experiments = corrected(experiments[0], corrections or {}), corrected(experiments[1], corrections or {})
        fitter = Fitter(nominal, view, *experiments, options.jobs, varies, memory=memory)
        fitter.most_runs = max(options.effort * RUNS - taken, AGAIN * options.effort * RUNS)
        try:
            with threadpool_limits(1, "blas"):  # rivals are spread over the cores, not the products within one
                return _diagnose(fitter, options, Progress(progress), began)
        finally:
            taken += fitter.runs
            fitter.close()

    result = by(_experiments(recordings, held_out))
    if derived:
        result = dataclasses.replace(result, notes=(DERIVED, *result.notes))
    if held_out and _only_held_out_shows(result):
        shared = by(_experiments((*recordings, *held_out), ()))
        if shared.verdict is Verdict.MISSING_PHYSICS:
            return dataclasses.replace(shared, notes=(SHARED, *shared.notes))
    return result


def _only_held_out_shows(result: Diagnosis) -> bool:
    """Whether the mismatch is unexplained, and is none on the recordings that were fitted."""
    best = result.fit["corrected"]
    clean = best.rms**2 < UNEXPLAINED * result.noise_floor**2
    return result.verdict is Verdict.UNEXPLAINED and clean and best.held_out_rms > SHOWN * result.noise_floor


def _varies(nominal: Axis, recording: Recording) -> tuple[str, ...]:
    """The linear parameters that the binding says each recording has of its own."""
    known = [p.name for p in nominal.chain.linear_parameters()]
    for name in recording.varies:
        if name not in known:
            raise InputError("[experiment] varies", f"unknown linear parameter {name!r}", ", ".join(known), "correct the name")
    return recording.varies


def _diagnose(fitter: Fitter, options: Options, progress: Progress, began: float) -> Diagnosis:
    progress.stage("compare", "refitting the nominal model")
    search, best, whitened = searched(fitter, options, progress, began)
    base = search.nominal()
    progress.stage("validate", "what is left, intervals, rivals")
    best = search.polish(_put_together(search, best))
    structure = remaining_structure(fitter, best)
    best = fitter.refined(best)
    mismatches = locate(fitter, base)
    found = _findings(search, best, options)
    motion = motion_errors(fitter, base, best)
    remains = _is_unexplained(search, base, search.held_out(best), structure, motion, options)
    remains = remains or _is_left_behind(fitter, base, best, options)
    astray = remains and _only_astray(fitter, base, best, options)
    settled = False
    if remains and not astray:
        # what the estimation recordings leave open is no missing physics: every recording may settle the parameters
        pooled = fitter.pooled(best)
        structure, motion = remaining_structure(fitter, pooled), (motion[0], motion_error(fitter, pooled))
        remains = _is_unexplained(search, base, fitter.validate(pooled), structure, motion, options)
        remains = remains or _left_on_estimation(fitter, base, pooled, options)
        settled = not remains
    errs = fit_beside_encoder(fitter, best, search.options.entry) if remains and not astray else None
    if errs is not None:
        # parameters that have bent to an encoder's error miss motion by it
        structure, motion = remaining_structure(fitter, errs), (motion[0], motion_error(fitter, errs))
        remains = _is_unexplained(search, base, fitter.validate(errs), structure, motion, options)
        remains = remains or _is_left_behind(fitter, base, errs, options)
    remains = remains and not astray
    verdict = _verdict(search, base, best, remains)
    mapped = fit_map(fitter, (base, best), search.held_out(best), progress) if verdict is Verdict.UNEXPLAINED else None
    notes = list(unphysical(fitter.nominal))
    notes += [
        f"{e.describe(fitter.nominal.chain.motion).removesuffix('.')}, as the nominal model had it: "
        "what was found has taken its place."
        for e in fitter.nominal.effects if e.key not in {kept.key for kept in best.hypothesis.carried}
    ]  # fmt: skip
    held, error = _held(fitter, best)
    if held:
        notes.append(
            f"{held} rows repeat velocity and angle of the row before to the last digit while the axis moves: the logger or the "
            "sensor held them. They are left out of every fit and error. This is no physics of the axis."
        )
    only_held = error > options.missed and verdict in (Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY)
    if only_held:
        verdict = Verdict.UNEXPLAINED  # what differs is known, but no effect of the library
    if motion[1] is not None and remains:
        notes.append(
            "Motion that the model misses, confirmed by the angle, has "
            f"{math.sqrt(max(motion[1], 0.0)):.2g} times the rms of the velocity noise on held-out data."
        )
    if structure.share > options.structure_share and structure.p_value < options.structure_p and not astray:
        notes.append(
            f"Structure remains that no known effect accounts for: the recorded input and motion predict "
            f"{100 * structure.share:.1f} % of the held-out residual energy (p = {structure.p_value:.1g})."
        )
    if remains and mapped is None:
        notes.append("No torque map over one or two state variables lowers the held-out error for sure: none is given.")
    if verdict is Verdict.UNEXPLAINED and fitter.noise_known and any(e.recording.loop == "closed" for e in fitter.experiments):
        notes.append(
            "The axis was under feedback. A torque that no model knows of (other axes, cables, the process) is missed motion in "
            "a free run; judged by force (--judge force) it counts as error, and what repeats in spite of it is named."
        )
    if settled:
        notes.append(
            "The estimation recordings leave parameters open that the held-out ones need: fitted to both together, the same "
            "structure leaves nothing material. Record more of what the held-out ones contain before trusting the parameters."
        )
    if astray:
        notes.append(
            "The free run goes astray on the held-out recording: bodies stick or strike at other moments, by an error of the "
            "parameters far within their intervals, and the rest follows. Where these leave no doubt of the motion nothing "
            "material is left: what remains is how far such events carry, and no missing physics."
        )
    if errs is not None and not remains:
        notes.append(
            "What is left repeats with the turn of the encoder, whatever the speed: the encoder errs, the axis does not move so."
        )
    if fitter.spent and verdict is Verdict.UNEXPLAINED:
        notes.append(
            f"The search ended once it had taken {fitter.most_runs:.0f} simulations, and left structures untried: "
            f"--effort {4 * options.effort:g} looks four times as long."
        )
    notes += _steps(search, best, _unit(fitter))
    notes += [
        f"The held-out recording hardly exercises {f.effect.replace('_', ' ')} at the {f.place}: it was judged on stretches of "
        "the estimation recordings that were held out of its fit. Record a held-out run that exercises it."
        for f in found if search.hardly_exercised(best, f"{f.form or f.effect}@{f.place}")
    ]  # fmt: skip
    second = judge_second_encoder(fitter.nominal.chain, fitter.experiments, fitter.held_out)
    notes += [second.sentence()] if second is not None else []
    if whitened:
        notes.append(
            "The residual is coloured; errors were whitened before rivals were compared, so that its correlation is counted."
        )
        if motion[1] is None:
            notes.append(
                "Coloured noise cannot be told from motion that the model misses, since one channel alone shows the motion: what "
                "is left was taken for noise. Record angle and velocity."
            )
    if "gain" not in " ".join(notes):
        notes.append(
            "A pure error of the torque gain cannot be told from a common scale of all inertias, stiffnesses and dampings; "
            "it is reported as changed parameters."
        )
    fits, gap = _figures(fitter, search, base, best)
    if mapped is not None:
        h, x = mapped.fitted.hypothesis, mapped.fitted.fit.x
        fits["mapped"] = _error_figures(fitter, lambda i: h.axis(x, i), mapped.fitted, mapped.held_out)
    experiment = fitter.experiments[0]
    unit = _unit(fitter)
    return Diagnosis(
        verdict=verdict,
        summary=HELD if only_held else _summary(verdict, found, fits, gap, fitter.noise_known, unit),
        findings=found if verdict in (Verdict.MISSING_PHYSICS, Verdict.UNEXPLAINED) else (),
        mismatch=mismatches[0],
        mismatches=mismatches,
        linear_parameters=estimates(best, fitter, owner=""),
        nominal_parameters={p.name: p.value for p in fitter.nominal.chain.linear_parameters()},
        nominal_effects=tuple(_carried(fitter, best, e) for e in best.hypothesis.carried),
        fit=fits,
        noise_floor=noise_rms(fitter, experiment) if fitter.noise_known else float("nan"),
        gap_closed=gap,
        rivals=_rivals(search, best),
        failed=dict(search.failed),
        notes=tuple(notes),
        next_experiment=next_experiment(fitter, search, best, found),
        channel=fitter.view.channel,
        unit=unit,
        view="motion (free run)" if fitter.view.channel == "velocity" else "force (inverse dynamics)",
        traces=_traces(fitter, base, best, mapped.fitted if mapped is not None else None),
        recordings=tuple(
            {"file": e.recording.source, "sha256": e.recording.sha256, "role": role}
            for role, group in (("estimation", fitter.experiments), ("held-out", fitter.held_out)) for e in group
        ),
        hypotheses=search.tested,
        false_alarm=false_alarm_rate(),
        seed=options.seed,
        seconds=time.monotonic() - began,
        versions=_versions(),
        map=mapped.result if mapped is not None else None,
    )  # fmt: skip


def _carried(fitter: Fitter, best: Fitted, effect: Effect) -> NominalEffect:
    """An effect of the nominal model, as it was given and as the best structure has it: what the recordings exercise of it."""
    found = estimates(best, fitter, owner=effect.key)
    said = len(best.fit.residual) - best.hypothesis.told[0]
    for e, column in zip(best.hypothesis.entries, best.fit.J[:said].T, strict=True):
        if e.owner == effect.key and not column.any():
            found.pop(e.name, None)
    return NominalEffect(effect.id, effect.place, _element(fitter, effect), effect.values, found)


def _element(fitter: Fitter, effect: Effect) -> str:
    chain = fitter.nominal.chain
    return chain.element(effect.place, coupling=effect.on_coupling(chain))


def _unit(fitter: Fitter) -> str:
    angular = fitter.nominal.chain.motion.value == "hinge"
    if fitter.view.channel == "velocity":
        return "rad/s" if angular else "m/s"
    return "N m" if angular else "N"


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {"python": platform.python_version(), **{n: version(n) for n in ("simgap", "mujoco", "numpy", "scipy", "numba")}}


def _findings(search: Search, best: Fitted, options: Options) -> tuple[Finding, ...]:
    out = []
    fewer = search.fitter.map([partial(search.without, best, effect) for effect in best.effects])
    for effect, poorer in zip(best.effects, fewer, strict=True):
        search.imitated(best, effect)
        p_held, p_fit, gain = p_values(search, poorer, best)
        before, after = search.held_out(poorer), search.held_out(best)
        numbers = estimates(best, search.fitter, owner=effect.key)
        out.append(
            Finding(
                effect=effect.name(),
                form=effect.form_of and effect.id,
                place=effect.place,
                element=_element(search.fitter, effect),
                sentence=effect.describe(search.fitter.nominal.chain.motion),
                parameters=numbers,
                evidence={
                    "held_out_error_before": before.rms if before else math.nan,
                    "held_out_error_after": after.rms if after else math.nan,
                    "p_value": min(1.0, p_held * max(1, search.tested)),
                    "p_value_estimation": p_fit,
                    "delta_chi2": gain,
                    "hypotheses": float(search.tested),
                },
                equivalents=equivalents(search, best, effect),
            )
        )
    out.sort(key=lambda f: -f.evidence["delta_chi2"])
    return tuple(out)


def _steps(search: Search, best: Fitted, unit: str) -> list[str]:
    """What the simpler form of each found effect achieves: how the refinement was reached."""
    out = []
    after = search.held_out(best)
    before = search.held_out(search.nominal())
    for effect in best.effects:
        rest = [k for k in best.key if k != effect.key]
        for simple in type(effect).refines:
            f = search.pool.get(tuple(sorted([*rest, f"{simple}@{effect.place}"])))
            held = search.held_out(f) if f is not None else None
            if held and after and before:
                out.append(
                    f"Held-out error {before.rms:.4g} {unit} for the refitted nominal model, {held.rms:.4g} with "
                    f"{simple.replace('_', ' ')}, {after.rms:.4g} with {effect.id.replace('_', ' ')}."
                    if not rest
                    else f"Held-out error {held.rms:.4g} {unit} with {simple.replace('_', ' ')} in place of "
                    f"{effect.id.replace('_', ' ')}, {after.rms:.4g} with it."
                )
    return out


def _closed(before: float, after: float) -> float:
    """Part of the rms error above the noise that was closed, from mean squares above the noise's, in units of its variance."""
    if before <= 0.0:
        return 0.0
    return 1.0 - (math.sqrt(1.0 + max(after, 0.0)) - 1.0) / (math.sqrt(1.0 + before) - 1.0)


def _is_unexplained(
    search: Search, base: Fitted, after: HeldOut | None, structure: Structure, motion: tuple[float | None, float | None],
    options: Options,
) -> bool:  # fmt: skip
    """Whether what is left on held-out data is material against the noise, and against the mismatch that there was.

    Two witnesses: the part of the held-out error that the input and the motion predict, and the motion that the angle confirms.
    """
    before = search.held_out(base)
    if before is None or after is None:
        return False
    predicted = structure.share * after.rms**2
    clear = structure.p_value < options.structure_p and structure.share > options.structure_share
    if not search.fitter.noise_known:
        return clear and predicted > options.left * before.rms**2
    variance = noise_rms(search.fitter, search.fitter.experiments[0]) ** 2
    mismatch, left = before.rms**2 / variance - 1.0, after.rms**2 / variance - 1.0
    if clear and _closed(mismatch, predicted / variance) < options.closed:
        return True
    missed_before, missed_after = motion
    if missed_before is None or missed_after is None or missed_after <= options.missed:
        return False
    # fast motion averages out in what the angle confirms: how much of all was closed is seen in the error itself
    return _closed(missed_before, missed_after) < options.closed and _closed(mismatch, left) < options.closed


def _is_left_behind(fitter: Fitter, base: Fitted, best: Fitted, options: Options) -> bool:
    """Whether a material error is left on the recordings that the model was fitted to, and the angle confirms it as motion.

    What a stand-in explains under one excitation it may leave under another, and that may be the one it was fitted to.
    """
    if not fitter.noise_known:
        return False
    left = best.chi2 / best.n - 1.0
    if left <= options.missed or _closed(base.chi2 / base.n - 1.0, left) >= options.closed:
        return False
    before, after = motion_errors(fitter, base, best, fitter.experiments)
    return before is not None and after is not None and after > options.missed and _closed(before, after) < options.closed


def _only_astray(fitter: Fitter, base: Fitted, best: Fitted, options: Options) -> bool:
    """Whether a held-out error is that of a free run which sticks or strikes at other moments, and no missing physics.

    Such a run goes astray by an error of its parameters far within their intervals. While models drawn by these stay together,
    or once the recorded velocity leads them at a rate that leaves an event no time to carry, the held-out recording still judges:
    so the model must leave no material error, and the nominal one much more than that.
    """
    if not fitter.noise_known or not best.rough or best.chi2 > (1.0 + options.missed) * best.n:
        return False

    def judged(before: float | None, after: float | None) -> bool:
        if before is None or after is None:
            return False
        # the noise that leads a model shakes it as well: what is left is little, or little of what there was
        little = after - 1.0 < options.missed or _closed(before - 1.0, after - 1.0) >= options.closed
        return little and before - 1.0 > POWER * options.missed

    samples = fitter.foretold(best)
    if samples is not None and judged(fitter.error_on(base, samples), fitter.error_on(best, samples)):
        return True
    return any(judged(*(fitter.led_error(f, rate) for f in (base, best))) for rate in EVENTS)


def _held(fitter: Fitter, best: Fitted) -> tuple[int, float]:
    """Rows of all recordings that were held and not measured, and the mean square error that they add, over the noise's."""
    if fitter.view.channel != "velocity":
        return 0, 0.0
    # one recording may be fitted in some blocks and held out in others
    experiments = {id(e.recording): e for e in (*fitter.held_out, *fitter.experiments)}
    count, most = 0, 0.0
    for experiment in experiments.values():
        rows = held_rows(experiment.recording)
        count += int(rows.sum())
        solved = fitter.own_values(best.hypothesis, best, experiment) if rows.any() and fitter.noise_known else None
        e = fitter.error(solved[0], experiment, solved[1]) if solved is not None else None
        if e is not None:
            most = max(most, float(np.sum(e[rows] ** 2)) / len(e) / noise_rms(fitter, experiment) ** 2)
    return count, most


def _left_on_estimation(fitter: Fitter, base: Fitted, pooled: Fitted, options: Options) -> bool:
    """Whether a model fitted to every recording leaves the estimation recordings a material error, whitened if need be."""
    r = fitter.residual(pooled.hypothesis)(pooled.fit.x) if fitter.noise_known else None
    if r is None:
        return False
    left = float(r @ r) / base.n - 1.0
    return left > options.missed and _closed(base.chi2 / base.n - 1.0, left) < options.closed


def _put_together(search: Search, best: Fitted) -> Fitted:
    """The same with one effect for two, where nothing tells them apart: the simplest name of a motion."""
    for effects in put_together(search.candidates, best.effects):
        simpler = search.fitter.fit(search.fitter.hypothesis(effects, best.linear, best.own), iterations=10)
        if simpler.ok and search.ahead(best, simpler) <= ALIKE_C:
            search.keep(simpler)
            return search.pool[simpler.key]
    return best


def _verdict(search: Search, base: Fitted, best: Fitted, remains: bool) -> Verdict:
    """Unexplained when a material part of the held-out residual is predictable; else by what was found."""
    if remains:
        return Verdict.UNEXPLAINED
    if best.effects:
        return Verdict.MISSING_PHYSICS
    fitter = search.fitter
    as_is = fitter.residual(base.hypothesis)(fitter.hypothesis(()).start)
    if as_is is None:
        return Verdict.PARAMETERS_ONLY
    count = len(base.hypothesis.entries)
    gain = base.n * math.log(float(as_is @ as_is) / base.chi2)
    return Verdict.PARAMETERS_ONLY if gain > search.options.entry + search.options.price * count / 2 else Verdict.NO_MISMATCH


def _error_figures(fitter: Fitter, axis_of: Callable[[int], Axis], fitted: Fitted | None, held: HeldOut | None) -> FitFigures:
    squares, spread, count = 0.0, 0.0, 0
    for i, experiment in enumerate(fitter.experiments):
        initial = None if fitted is None else fitted.hypothesis.initial(fitted.fit.x, i)
        s = fitter.view.signals(axis_of(i), experiment, initial)
        if s is None:
            return FitFigures(math.nan, math.nan, math.nan, math.nan)
        keep = fitter.counted(experiment)
        m = s.measured[keep]
        squares += float(np.sum((s.measured - s.predicted)[keep] ** 2))
        spread += float(np.sum((m - m.mean()) ** 2))
        count += int(keep.sum())
    rms = math.sqrt(squares / count)
    held_rms, held_nrmse = (held.rms, held.nrmse) if held else (math.nan, math.nan)
    ahead = k_step(fitter, fitted) if fitted is not None and held is not None else ()
    return FitFigures(rms, math.sqrt(squares / spread), held_rms, held_nrmse, ahead)


def _figures(fitter: Fitter, search: Search, base: Fitted, best: Fitted) -> tuple[dict[str, FitFigures], float]:
    """Errors of the nominal model as given, refitted and corrected; and the share of the held-out gap that is closed."""
    as_given = Fitted(base.hypothesis, _at(base, fitter.hypothesis(()).start), base.n)

    def of(f: Fitted) -> FitFigures:
        return _error_figures(fitter, lambda i: f.hypothesis.axis(f.fit.x, i), f, search.held_out(f))

    def given() -> FitFigures:
        return _error_figures(fitter, lambda _: fitter.nominal, None, fitter.validate(as_given))

    names = ("nominal", "refitted", "corrected")
    tasks = (given, partial(of, base), partial(of, best))
    fits = dict(zip(names, fitter.map(tasks), strict=True))
    before, after = fits["refitted"].held_out_rms, fits["corrected"].held_out_rms
    floor = float(np.mean([noise_rms(fitter, e) for e in fitter.held_out])) if fitter.noise_known else 0.0
    gap = (before - after) / (before - floor) if before > floor * 1.0001 else math.nan
    return fits, gap if best.effects else math.nan


def _at(fitted: Fitted, x: np.ndarray) -> Fit:
    return dataclasses.replace(fitted.fit, x=x)


def _rivals(search: Search, best: Fitted, most: int = 25) -> tuple[Rival, ...]:
    reference = search.criterion(best)
    out: list[Rival] = []
    ranked = sorted(search.pool.values(), key=search.criterion)[:most]
    lengths = [n * (10.0 if i < JUDGED else 1.0) for i, n in enumerate(search.fitter.lengths(ranked))]

    def figures(f: Fitted, judged: bool) -> tuple[HeldOut | None, float]:
        return search.held_out(f) if judged else search.held.get(f.key), _rms(search.fitter, f)

    told = search.fitter.map([partial(figures, f, i < JUDGED) for i, f in enumerate(ranked)], lengths)
    for f, (held, rms) in zip(ranked, told, strict=True):
        out.append(
            Rival(f.key, len(f.hypothesis.entries), rms, held.rms if held else math.nan,
                  search.criterion(f) - reference, f.fit.status.name.lower())
        )  # fmt: skip
    return tuple(out)


def _rms(fitter: Fitter, fitted: Fitted) -> float:
    """Estimation error in the view's unit, without whitening."""
    return _error_figures(fitter, lambda i: fitted.hypothesis.axis(fitted.fit.x, i), fitted, None).rms


def _traces(fitter: Fitter, base: Fitted, best: Fitted, mapped: Fitted | None = None) -> tuple[Traces, ...]:
    out = []
    for role, group in (("estimation", fitter.experiments), ("held-out", fitter.held_out)):
        for i, experiment in enumerate(group):
            runs: list[tuple[Axis, np.ndarray | None]] = [(fitter.nominal, None)]
            for f in (base, best, *([] if mapped is None else [mapped])):
                if role == "estimation":
                    runs.append((f.hypothesis.axis(f.fit.x, i), f.hypothesis.initial(f.fit.x, i)))
                else:
                    runs.append(fitter.own_values(f.hypothesis, f, experiment) or (f.axis, None))
            signals = fitter.map([partial(fitter.view.signals, axis, experiment, initial) for axis, initial in runs])
            given, refitted, corrected, *more = signals
            if refitted is None or corrected is None:
                continue
            out.append(
                Traces(experiment.recording.source, role, refitted.time, refitted.measured, given.predicted if given else None,
                       refitted.predicted, corrected.predicted, fitter.counted(experiment),
                       noise_rms(fitter, experiment) if fitter.noise_known else math.nan,
                       more[0].predicted if more and more[0] else None)
            )  # fmt: skip
    return tuple(out)


def _summary(
    verdict: Verdict, findings: Sequence[Finding], fits: dict[str, FitFigures], gap: float, known: bool, unit: str
) -> str:
    """The answer in one sentence."""
    before, after = fits["refitted"].held_out_rms, fits["corrected"].held_out_rms
    names = " and ".join(f"{f.effect.replace('_', ' ').replace('coulomb', 'Coulomb')} at the {f.place}" for f in findings)
    match verdict:
        case Verdict.NO_MISMATCH:
            return "Nothing is missing: the nominal model agrees with the recording to within its noise."
        case Verdict.PARAMETERS_ONLY if not known:  # by force: of what is left nobody knows how much is noise
            return (
                "No missing physics can be named: with its parameters adjusted the nominal structure misses the held-out force "
                f"by {100 * fits['corrected'].held_out_nrmse:.3g} % of its variation, and no known effect reliably lowers that."
            )
        case Verdict.PARAMETERS_ONLY:
            return "No physics is missing: the nominal structure fits once its parameters are adjusted."
        case Verdict.MISSING_PHYSICS:
            share = min(100.0, 100 * gap)
            closed = f", by {share:.1f} % of what {'exceeded the noise' if known else 'it was'}" if math.isfinite(gap) else ""
            return (
                f"The simulation left out {names}: putting it back lowers the held-out error "
                f"from {before:.4g} to {after:.4g} {unit}{closed}."
            )
        case Verdict.UNEXPLAINED:
            accounts = "accounts" if len(findings) == 1 else "account"
            part = f" {names} {accounts} for part of it (held-out error {before:.4g} to {after:.4g}), but" if findings else ""
            return f"The mismatch is not explained:{part} structure remains that none of the known effects accounts for."
