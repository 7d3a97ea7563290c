"""The numbers of corrected.xml as those of the diagnosis, where plain MuJoCo explains recordings that the equations do not.

The equations are then biased: ideal friction has no creep, and their integration no timestep. The numbers that were refitted in
MuJoCo follow the recordings to the noise, and their intervals hold the truth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from diagnose.evidence.intervals import half_width
from diagnose.result import Diagnosis, Estimate, Finding
from diagnose.thresholds import UNEXPLAINED
from diagnose.verdict.reference import Case, Run, at_noise, figures
from diagnose.verdict.reference_fit import standard_errors
from mjsim.axis import Axis
from mjsim.mjcf import load_axis
from mjsim.quantity import Motion
from simgap.found import effect_found

__all__ = ["with_numbers_of_file"]


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
