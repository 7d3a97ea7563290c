"""The weakest of several effects left out where the user's simulator does as well without it.

The equations of motion are exact, a simulator steps them. What its integrator adds or takes (half a timestep of delay, a little
damping) is found as a small effect beside a large one. MuJoCo has it in the file without that effect too.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from diagnose.problem.noise_model import KnownNoise
from diagnose.result import Diagnosis, Finding
from diagnose.thresholds import SMALL
from diagnose.verdict.reference import Run, at_noise, chi_square
from diagnose.verdict.reference_fit import refit_in_simulator
from diagnose.verdict.reference_runs import run_files, starts_of
from diagnose.verdict.reference_stage import Nominal
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf.faithful import Faithful
from mjsim.plant import MujocoPlant

__all__ = ["without_weakest"]


def without_weakest(
    given: Axis, axis: Axis, result: Diagnosis, nominal: Nominal, form: Faithful, runs: Sequence[Run | None], out: Path,
    threads: int,
) -> tuple[Diagnosis, Axis, Sequence[Run | None]] | None:  # fmt: skip
    """The diagnosis, the axis and the runs of its file without the weakest effect; None where that is needed.

    Of several effects the weakest is the one of the smallest gain on held-out data. One that gains a small share of the squared
    error is asked about: it is needed where the file without it, its numbers refitted in MuJoCo, has a chi-square that is higher
    by more than the price of the effect, on estimation or on held-out data, or does not come to the noise. ``out`` is rewritten
    where it is left out.
    """
    weakest = _weakest(given, axis, result)
    if weakest is None or form.lacks:
        return None
    level = KnownNoise.prices.entry + 0.5 * KnownNoise.prices.price * len(weakest.parameters)
    goals = {part: chi_square(nominal.cases, runs, part)[0] + level for part in ("estimation", "held_out")}
    fewer = axis.without(f"{weakest.law}@{weakest.place}")
    trial = out.with_name(f".{out.stem}.fewer.part.xml")
    try:
        with contextlib.suppress(InputError):
            starts = starts_of(fewer, nominal.cases)
            better = refit_in_simulator(fewer, form.write, out.name, nominal.cases, starts, threads, goals["estimation"])
            if better is None or better.chi2 > goals["estimation"] or form.write(better.axis, trial):
                return None
            after = run_files([MujocoPlant.load(trial)], nominal.cases, threads)[0]
            above = any(chi_square(nominal.cases, after, part)[0] > goal for part, goal in goals.items())
            if above or not at_noise(nominal.cases, after):
                return None
            trial.replace(out)
            return _told(result, weakest), better.axis, after
        return None
    finally:
        trial.unlink(missing_ok=True)


def _weakest(given: Axis, axis: Axis, result: Diagnosis) -> Finding | None:
    """The effect of the smallest held-out gain beside others, where that is small; None where it took one of the file's place."""
    physics = [f for f in result.findings if f.kind == "physics"]
    if len(physics) < 2:
        return None
    first = min(physics, key=_gain)
    effect = next((e for e in axis.effects if e.key == f"{first.law}@{first.place}"), None)
    if effect is None or len(given.kept_beside([effect])) < len(given.effects):
        return None
    return first if _gain(first) < SMALL else None


def _gain(f: Finding) -> float:
    """Relative fall of the held-out squared error by an effect."""
    before, after = (f.evidence.get(f"held_out_error_{when}", 0.0) for when in ("before", "after"))
    return 1.0 - (after / before) ** 2 if before > 0 else 0.0


def _told(result: Diagnosis, left: Finding) -> Diagnosis:
    """The diagnosis without a finding. The numbers of the others stay those of the equations, which step exactly."""
    name = effect_class(left.law).name().replace("_", " ")
    note = (
        f"{name[:1].upper()}{name[1:]} at the {left.place} is not named: the equations of motion ask for it, and in MuJoCo the "
        "corrected file follows the recordings as well without it. It compensates for the integration error of the simulator."
    )
    found = tuple(f for f in result.findings if f is not left)
    return dataclasses.replace(result, findings=found, notes=(note, *result.notes))
