"""The numbers of corrected.xml as those of the diagnosis, where plain MuJoCo explains recordings that the equations do not.

The equations are then biased: ideal friction has no creep, and their integration no timestep. The numbers that were refitted in
MuJoCo follow the recordings to the noise, and their intervals hold the truth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from diagnose.data.experiment import prepare
from diagnose.data.scales import scales_by_place
from diagnose.evidence.intervals import half_width
from diagnose.result import Diagnosis, Estimate, Finding, Verdict
from diagnose.thresholds import UNEXPLAINED
from diagnose.verdict.reference import Case, Run, at_noise, figures
from diagnose.verdict.reference_fit import standard_errors
from mjsim.axis import Axis
from mjsim.mjcf import load_axis
from mjsim.quantity import Motion
from simgap.found import effect_found

__all__ = ["with_numbers_of_file", "without_short_times"]


def with_numbers_of_file(
    result: Diagnosis, path: Path, cases: Sequence[Case], runs: Sequence[Run | None], *, other: bool = False
) -> Diagnosis:
    """The diagnosis with the numbers of a file and their 95 % intervals; as it is where the equations leave as little.

    ``runs``: of the file in plain MuJoCo, at the noise on estimation and held-out data, else nothing is taken from it; nor where
    it has ``other`` physics than the diagnosis. Starts, phases and numbers that no refit frees keep their estimates.
    """
    if other or not at_noise(cases, runs) or result.fit["corrected"].rms ** 2 <= UNEXPLAINED * figures(cases, runs).rms ** 2:
        return result
    axis = load_axis(path)
    errors = standard_errors(axis, cases, [run.start for run in runs if run is not None])
    values = _values(axis)
    return dataclasses.replace(
        result,
        linear_parameters={
            name: _estimate(values[name], errors[name], old) if name in errors else old
            for name, old in result.linear_parameters.items()
        },
        findings=tuple(
            f if f.kind != "physics" else _of_file(f, values, errors, axis.chain.motion) for f in result.findings
        ),
    )  # fmt: skip


def without_short_times(result: Diagnosis, axis: Axis, cases: Sequence[Case]) -> Diagnosis:
    """The diagnosis without effects whose time, by the numbers of the file, is too short to be told from the command's hold.

    The equations found a time that the log can show, and MuJoCo, whose timestep delays the drive as well, leaves less of it. The
    file keeps it, as a number of how the command goes between the samples. axis: of the file as given.
    """
    physics = [f for f in result.findings if f.kind == "physics"]
    if not physics:
        return result
    scales = scales_by_place(axis, prepare(cases[0].recording, minimum=0))  # the search has asked for enough samples
    ranges = ((f, r) for f in physics for r in effect_found(f).admissible(scales[f.place]))
    short = {id(f): (f, r) for f, r in ranges if r.is_below}
    if not short:
        return result
    notes = tuple(
        f"{f.effect.replace('_', ' ').capitalize()} at the {f.place} is not named: in MuJoCo its {r.what} is {r.value:.3g}, "
        f"below {r.low:.3g}, {r.why}. corrected.xml keeps it."
        for f, r in short.values()
    )
    left = tuple(f for f in result.findings if id(f) not in short)
    out = dataclasses.replace(result, findings=left, notes=(*notes, *result.notes))
    if result.verdict is not Verdict.MISSING_PHYSICS or any(f.kind == "physics" for f in left):
        return out
    summary = "No physics is missing: the numbers of the model were off, and how the command goes between samples is not known."
    return dataclasses.replace(out, verdict=Verdict.PARAMETERS_ONLY, summary=summary)


def _values(axis: Axis) -> dict[str, float]:
    """Numbers of an axis by name, those of effects as ``id@place.name``."""
    linear = {p.name: p.value for p in axis.chain.linear_parameters()}
    return linear | {f"{e.key}.{name}": value for e in axis.effects for name, value in e.values.items()}


def _estimate(value: float, error: float, old: Estimate) -> Estimate:
    half = half_width(abs(value) * error)
    return Estimate(value, (value - half, value + half), old.unit)


def _of_file(f: Finding, values: Mapping[str, float], errors: Mapping[str, float], motion: Motion) -> Finding:
    """A finding at the numbers that the file has of it."""
    names = {name: f"{f.law}@{f.place}.{name}" for name in f.parameters}
    if not any(key in errors for key in names.values()):
        return f
    numbers = {
        name: _estimate(values[names[name]], errors[names[name]], old) if names[name] in errors else old
        for name, old in f.parameters.items()
    }
    moved = dataclasses.replace(f, parameters=numbers)
    return dataclasses.replace(moved, sentence=effect_found(moved).describe(motion))
