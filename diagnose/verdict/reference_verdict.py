"""The verdict by the user's simulator: figures of the files as MuJoCo steps them, and what follows from them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

from diagnose.problem.noise_model import KnownNoise
from diagnose.result import Diagnosis, Finding, FitFigures, Verdict
from diagnose.verdict.reference import Run, at_noise, chi_square, figures
from diagnose.verdict.reference_stage import APART, Nominal
from diagnose.verdict.simulator_traces import with_runs

__all__ = ["MISSES", "Files", "by_simulator", "gains_little", "no_better", "nominal_stands"]

MISSES = 1.1  # times the error that the fitting engine reports, beyond which the file's own is said


@dataclass(frozen=True, eq=False)
class Files:
    """What MuJoCo makes of the corrected file: its runs on the cases, what it lacks, its form.

    numerics: findings of that class; sensitive: whether the smallest change of the start or the numbers leads elsewhere;
    bears: whether findings were dropped since the simulator's numerics explain the recordings as well; stands: whether the
    file is the one as given, since no other is better (`no_better`).
    """

    runs: Sequence[Run | None]
    lacks: tuple[str, ...]
    form: str
    numerics: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    sensitive: bool = False
    bears: bool = False
    stands: bool = False


def by_simulator(result: Diagnosis, nominal: Nominal, files: Files) -> Diagnosis:
    """The diagnosis with MuJoCo's figures, and the verdict that they bear.

    ``fit.nominal`` and ``fit.corrected`` become those of the files, ``surrogate`` keeps those of the engine.
    """
    engine = {name: result.fit[name] for name in ("nominal", "refitted", "corrected") if name in result.fit}
    fits = dict(result.fit)
    fits["nominal"], fits["corrected"] = figures(nominal.cases, nominal.runs), figures(nominal.cases, files.runs)
    notes = [*files.notes]
    missed = _missed(fits["corrected"], engine["corrected"])
    if files.lacks and missed:
        notes.append(
            f"Plain MuJoCo lacks in corrected.xml: {'; '.join(files.lacks)}. Its held-out error there is "
            f"{_told(fits['corrected'].held_out_rms)} {result.unit}, with these in simgap's replay "
            f"{engine['corrected'].held_out_rms:.4g} {result.unit}."
        )
    shown = with_runs(result.traces, nominal.cases, nominal.runs, files.runs)
    out = dataclasses.replace(result, fit=fits, surrogate=engine, traces=shown)
    if files.stands or nominal_stands(result, nominal):
        return _no_mismatch(out, notes) if at_noise(nominal.cases, nominal.runs, angles=True) else _as_it_was(out, notes)
    if missed and not files.lacks:
        notes.insert(0, _warning(fits["corrected"], engine["corrected"], result.unit, files.sensitive))
    out = dataclasses.replace(out, findings=(*result.findings, *files.numerics), notes=(*notes, *result.notes))
    if files.numerics:
        out = _numerics(out, files)
    if out.verdict is Verdict.NO_MISMATCH and not at_noise(nominal.cases, nominal.runs):
        out = dataclasses.replace(out, verdict=Verdict.PARAMETERS_ONLY, summary=_as_given(out))
    elif files.bears or (out.verdict is Verdict.UNEXPLAINED and at_noise(nominal.cases, files.runs, angles=True)):
        out = _explained(out, files.form)
    # a file that follows the held-out recordings worse than the one as given explains nothing, whatever the equations say
    worse = fits["corrected"].held_out_rms > MISSES * fits["nominal"].held_out_rms and not at_noise(nominal.cases, files.runs)
    if worse and not files.lacks:
        if out.verdict in (Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY):
            return dataclasses.replace(out, verdict=Verdict.UNEXPLAINED, summary=_worse(out))
        out = dataclasses.replace(out, notes=(_warning_worse(out), *out.notes))
    # an effect that the equations explain keeps its name; the warning says that the file does not step it
    told = files.lacks or files.sensitive or out.verdict in (Verdict.UNEXPLAINED, Verdict.MISSING_PHYSICS)
    if missed and not told and not at_noise(nominal.cases, files.runs):
        return dataclasses.replace(out, verdict=Verdict.UNEXPLAINED, summary=_unreached(out))
    if out.verdict is Verdict.MISSING_PHYSICS and not files.bears and not files.numerics:
        return dataclasses.replace(out, summary=_lacked(out, files.lacks))
    return out


def nominal_stands(result: Diagnosis, nominal: Nominal) -> bool:
    """Whether the given file is at the noise and as good as the best model, by the numbers that this one has more.

    Where search and simulator had the same numerics the search has answered that, with every one of its tests.
    """
    if (nominal.apart <= APART or nominal.simulator) and result.verdict is not Verdict.NO_MISMATCH:
        return False
    return at_noise(nominal.cases, nominal.runs, angles=True) and _as_good(
        result, nominal, (result.surrogate or result.fit)["corrected"]
    )


def gains_little(result: Diagnosis, nominal: Nominal, runs: Sequence[Run | None]) -> bool:
    """Whether the given file is at the noise and as good as the corrected one or better, as MuJoCo runs both.

    What the equations found then makes up for how they differ from MuJoCo, and for nothing in the recordings.
    """
    return at_noise(nominal.cases, nominal.runs, angles=True) and _as_good(result, nominal, figures(nominal.cases, runs))


def _as_good(result: Diagnosis, nominal: Nominal, best: FitFigures) -> bool:
    """Whether the given file's chi-square exceeds that of other figures by no more than the numbers that these have more.

    On estimation and on held-out data; or it is less than theirs on held-out data by more than that, whatever these gain on the
    data that they were fitted to.
    """
    gain, lost, level = _gains(result, nominal, best)
    return (gain <= level and lost <= level) or lost < -level


def _gains(result: Diagnosis, nominal: Nominal, best: FitFigures) -> tuple[float, float, float]:
    """Twice the log-likelihood by which figures exceed the given file's on estimation and held-out data, and the numbers' price.

    Infinite where the given file diverges, or nothing is fitted.
    """
    given = figures(nominal.cases, nominal.runs)
    chi2, n = chi_square(nominal.cases, nominal.runs)
    more = len(result.linear_parameters) + sum(len(f.parameters) for f in result.findings)
    level = KnownNoise.prices.entry + 0.5 * KnownNoise.prices.price * more
    if not (math.isfinite(chi2) and n):
        return math.inf, math.inf, level
    held = sum(int(c.held_out.sum()) for c in nominal.cases)
    lost = held * 2.0 * _log_ratio(given.held_out_rms, best.held_out_rms) if held else 0.0
    return n * 2.0 * _log_ratio(given.rms, best.rms), lost, level


def _log_ratio(a: float, b: float) -> float:
    """log(a / b) of errors; -inf where b diverges."""
    return math.log(max(a, 1e-300)) - math.log(max(b, 1e-300))


def no_better(result: Diagnosis, nominal: Nominal, runs: Sequence[Run | None]) -> bool:
    """Whether changed numbers alone make the file no better than the one as given.

    Neither on estimation nor on held-out data, or worse on held-out data by more than the numbers are worth (`_as_good`). Numbers
    that are fitted by the equations then make up for how MuJoCo steps the file, and for nothing in the recordings. Where the
    file as given is at the noise, it explains what these leave unexplained; where it is not, the mismatch is unexplained.
    """
    if result.verdict not in (Verdict.PARAMETERS_ONLY, Verdict.UNEXPLAINED) or result.findings:
        return False
    _, lost, level = _gains(result, nominal, figures(nominal.cases, runs))
    parts = ("estimation", "held_out")
    neither = all(chi_square(nominal.cases, nominal.runs, p)[0] <= chi_square(nominal.cases, runs, p)[0] for p in parts)
    return neither or lost < -level


def _missed(fit: FitFigures, engine: FitFigures) -> bool:
    pairs = ((fit.rms, engine.rms), (fit.held_out_rms, engine.held_out_rms))
    return any(not a <= MISSES * b for a, b in pairs if not math.isnan(b))


def _told(x: float) -> str:
    return f"{x:.4g}" if math.isfinite(x) else "infinite (it diverges)"


def _warning(fit: FitFigures, engine: FitFigures, unit: str, sensitive: bool) -> str:
    why = (
        "the smallest change of where it starts or of its numbers leads elsewhere: such a motion cannot be followed for long"
        if sensitive
        else "MuJoCo does not step what was found as the equations say"
    )
    return (
        f"Warning: corrected.xml in plain MuJoCo has a held-out error of {_told(fit.held_out_rms)} {unit} (estimation "
        f"{_told(fit.rms)}), and not the {engine.held_out_rms:.4g} ({engine.rms:.4g}) of the fitting engine; {why}."
    )


def _no_mismatch(result: Diagnosis, notes: Sequence[str]) -> Diagnosis:
    """The given file stands; what the engine had found beside it is told in a note."""
    found = " and ".join(f.effect.replace("_", " ") for f in result.findings)
    more = f"The fitting engine alone would have named {found}; the simulator with the file as given needs none of it."
    kept = [n for n in notes if not n.startswith("Plain MuJoCo lacks")]
    return dataclasses.replace(
        result, verdict=Verdict.NO_MISMATCH, findings=(), gap_closed=math.nan, next_experiment=None, map=None,
        fit={**result.fit, "corrected": result.fit["nominal"]},
        summary="Nothing is missing: the nominal model, stepped by MuJoCo with its own options, agrees with the recording "
        "to within its noise.",
        notes=(*([more] if found else []), *kept, *(n for n in result.notes if "Structure remains" not in n)),
    )  # fmt: skip


def _as_it_was(result: Diagnosis, notes: Sequence[str]) -> Diagnosis:
    """No change of the numbers makes the file follow the recordings better in MuJoCo, and it does not follow them."""
    given = result.fit["nominal"]
    return dataclasses.replace(
        result, verdict=Verdict.UNEXPLAINED, fit={**result.fit, "corrected": given}, gap_closed=math.nan,
        summary=f"The mismatch is not explained: stepped by MuJoCo, the file as given misses held-out recordings by "
        f"{_told(given.held_out_rms)} {result.unit}, and no change of its numbers does better: corrected.xml is the same.",
        notes=(*(n for n in notes if not n.startswith("Plain MuJoCo lacks")), *result.notes),
    )  # fmt: skip


def _warning_worse(result: Diagnosis) -> str:
    given, mended = result.fit["nominal"], result.fit["corrected"]
    return (
        f"Warning: in MuJoCo, corrected.xml follows the held-out recordings worse ({_told(mended.held_out_rms)} {result.unit}) "
        f"than the file as given ({_told(given.held_out_rms)}); on the estimation data their errors are {_told(mended.rms)} and "
        f"{_told(given.rms)}."
    )


def _numerics(result: Diagnosis, files: Files) -> Diagnosis:
    """Say that a setting and not physics makes the difference."""
    names = " and ".join(f.effect.replace("_", " ") for f in files.numerics)
    f = files.numerics[0].evidence
    told = (
        f"A setting of the simulator makes a difference, not physics: {names}. Mended in corrected.xml, the held-out error is "
        f"{f['held_out_error_after']:.4g} {result.unit} instead of {f['held_out_error_before']:.4g}."
    )
    if result.verdict in (Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY):
        return dataclasses.replace(result, verdict=Verdict.PARAMETERS_ONLY, summary=f"No physics is missing. {told}")
    first = _lacked(result, files.lacks) if result.verdict is Verdict.MISSING_PHYSICS else result.summary
    return dataclasses.replace(result, summary=f"{first} {told}")


_UNMADE = ("Structure remains", "No torque map", "Motion that the model misses", "has taken its place", "in place of")  # of notes


def _explained(result: Diagnosis, form: str) -> Diagnosis:
    """What the equations leave unexplained, the corrected file in MuJoCo does not: its numerics are in the recordings."""
    physics = [f for f in result.findings if f.kind == "physics"]
    names = _names(result)
    what = f"The simulation left out {names}" if names else "No physics is missing: the numbers of the model were off"
    fit, engine = result.fit["corrected"], result.surrogate["corrected"]
    return dataclasses.replace(
        result, verdict=Verdict.MISSING_PHYSICS if physics else Verdict.PARAMETERS_ONLY, map=None,
        summary=f"{what}: corrected.xml, stepped by MuJoCo, has a held-out error of {fit.held_out_rms:.4g} {result.unit}, "
        "which is noise.",
        notes=(
            f"The recordings bear the simulator's numerics: with {form} the file follows them, and the equations of motion leave "
            f"{engine.held_out_rms:.4g} {result.unit}.",
            *(n for n in result.notes if not any(part in n for part in _UNMADE)),
        ),
    )  # fmt: skip


def _lacked(result: Diagnosis, lacks: Sequence[str]) -> str:
    """What is missing, by the figures of the two files in MuJoCo; by the engine's where MJCF has no element for it."""
    given, mended, engine = result.fit["nominal"], result.fit["corrected"], result.surrogate["corrected"]
    what = f"The simulation left out {_names(result)}: on held-out data the file as given misses by {_told(given.held_out_rms)}"
    if lacks:
        return (
            f"{what} {result.unit} in MuJoCo, corrected.xml by {_told(mended.held_out_rms)}, and by {engine.held_out_rms:.4g} in "
            "simgap's replay, which has what MJCF lacks."
        )
    return f"{what}, corrected.xml by {_told(mended.held_out_rms)} {result.unit}, both stepped by MuJoCo."


def _names(result: Diagnosis) -> str:
    physics = [f for f in result.findings if f.kind == "physics"]
    return " and ".join(f"{f.effect.replace('_', ' ').replace('coulomb', 'Coulomb')} at the {f.place}" for f in physics)


def _as_given(result: Diagnosis) -> str:
    given, mended = result.fit["nominal"], result.fit["corrected"]
    return (
        f"No physics is missing: the equations agree with the recording. The file as given, stepped by MuJoCo, misses it by "
        f"{_told(given.held_out_rms)} {result.unit} on held-out data, corrected.xml by {_told(mended.held_out_rms)}."
    )


def _worse(result: Diagnosis) -> str:
    given, mended = result.fit["nominal"], result.fit["corrected"]
    return (
        f"The mismatch is not explained: by the numbers that suit the equations best, the file misses held-out recordings by "
        f"{_told(mended.held_out_rms)} {result.unit} in MuJoCo, as given by {_told(given.held_out_rms)}. It holds what the "
        "equations do not, such as a limit that the joint reaches."
    )


def _unreached(result: Diagnosis) -> str:
    fit, engine = result.fit["corrected"], result.surrogate["corrected"]
    return (
        f"The equations of motion explain the recording (held-out error {engine.held_out_rms:.4g} {result.unit}), but "
        f"corrected.xml in plain MuJoCo does not ({_told(fit.held_out_rms)} {result.unit})."
    )
