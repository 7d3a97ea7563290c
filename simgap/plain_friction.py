"""Dry friction as the simulator has it, in place of a richer law that fits as well in the equations of motion.

MuJoCo's dry friction is soft: it creeps at rest. A recording of MuJoCo, or of a machine that creeps alike, is then followed by
plain Coulomb friction in MuJoCo, where the equations with ideal friction ask for a law of more parameters.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path

from diagnose.evidence.intervals import half_width
from diagnose.result import Diagnosis, Estimate, Finding
from diagnose.verdict.reference import Case, Run, at_noise, figures, noise_level
from diagnose.verdict.reference_fit import Refit, refit_in_simulator
from diagnose.verdict.reference_runs import run_files, starts_of
from diagnose.verdict.reference_stage import Nominal
from mjsim.axis import Axis
from mjsim.effects import Effect, effect_class
from mjsim.errors import InputError
from mjsim.mjcf.faithful import AUTHOR, Faithful, Writer, write_as_author
from mjsim.plant import MujocoPlant
from simgap.found import effect_found

__all__ = ["plainer_friction", "refit_to_noise"]


def plainer_friction(
    model: Path, given: Axis, result: Diagnosis, nominal: Nominal, out: Path, threads: int, *, itself: bool = False
) -> tuple[Diagnosis, Faithful, Sequence[Run | None]] | None:
    """The diagnosis with the simplest friction in place of richer laws, refitted in MuJoCo with the author's settings.

    Other effects are left out where friction alone leaves noise. ``itself``: the simplest law too is refitted with those
    settings, once richer laws alone were tried. None where there is no such law, or where the simplest one is not at the noise on
    both kinds of data. Writes ``out``.
    """
    physics = [f for f in result.findings if f.kind == "physics"]
    richer = {f.law: _simplest(f, itself) for f in physics}
    if not any(richer.values()) or (itself and richer == {f.law: _simplest(f, False) for f in physics}):
        return None
    alone = [f for f in result.findings if f.kind != "physics" or richer[f.law]]
    groups = [alone, list(result.findings)] if len(alone) < len(result.findings) else [alone]
    write = partial(write_as_author, model)
    fitted = given.with_values({k: v.value for k, v in result.linear_parameters.items()})
    refitted, group = None, alone
    for group, start in product(groups, (fitted, given)):  # numbers fitted beside a richer law may lead to another minimum
        effects = [richer.get(f.law) or effect_found(f) for f in group if f.kind == "physics"]
        with contextlib.suppress(InputError, ValueError):
            refitted = refit_to_noise(start.with_effects(effects), write, nominal.cases, out, threads)
        if refitted is not None:
            break
    if refitted is None:
        return None
    better, lacks, runs = refitted
    held = figures(nominal.cases, runs).held_out_rms
    found = tuple(_finding(f, better, e, given, held) if (e := richer.get(f.law)) else f for f in group)
    imitated = [f for f in physics if (effect_class(f.law).refines and richer[f.law]) or f not in group]
    names = " and ".join(f.effect.replace("_", " ") for f in imitated)
    if names:
        note = (
            f"The equations of motion with ideal friction ask for {names}. In MuJoCo with the file's own settings the simpler "
            "law leaves noise alone: the rest is the creep of its soft friction."
        )
        result = dataclasses.replace(result, notes=(note, *result.notes))
    return dataclasses.replace(result, findings=found), Faithful(AUTHOR, math.nan, lacks, write), runs


def refit_to_noise(
    axis: Axis, write: Writer, cases: Sequence[Case], out: Path, threads: int
) -> tuple[Refit, tuple[str, ...], Sequence[Run | None]] | None:
    """An axis refitted in MuJoCo, written to ``out``: the refit, what plain MuJoCo lacks, the runs.

    None where it does not come to the noise on both kinds of data, as soon as that is clear. Raises InputError where it cannot
    be written.
    """
    goal = noise_level(sum(int(c.estimation.sum()) for c in cases))
    better = refit_in_simulator(axis, write, out.name, cases, starts_of(axis, cases), threads, goal)
    if better is None:
        return None
    lacks = write(better.axis, out)
    runs = run_files([MujocoPlant.load(out)], cases, threads)[0]
    return (better, lacks, runs) if at_noise(cases, runs) else None


def _simplest(f: Finding, itself: bool) -> Effect | None:
    """The simplest law of friction that a found one refines, at the numbers that they share; None where there is none.

    ``itself``: a law that refines none counts as its own simplest form.
    """
    cls = effect_class(f.law)
    simpler = [effect_class(name) for name in cls.refines if effect_class(name).family == "friction"]
    if cls.family == "friction" and not cls.refines and itself:
        return effect_found(f)
    if cls.family != "friction" or not simpler:
        return None
    simplest = simpler[-1]
    names = [spec.name for spec in simplest.specs()]
    if not set(names) <= set(f.parameters) or f.place not in simplest.places:
        return None
    return simplest(place=f.place, **{name: f.parameters[name].value for name in names})


def _finding(f: Finding, better: Refit, simplest: Effect | None, given: Axis, held: float) -> Finding:
    """The finding of the simpler law at the numbers that were refitted in MuJoCo, with their intervals."""
    assert simplest is not None
    motion = given.chain.motion
    numbers, values = {}, {}
    for spec in simplest.specs():
        name = f"{simplest.key}.{spec.name}"
        value = values[spec.name] = better.values.get(name, simplest.values[spec.name])
        half = half_width(1.0) * abs(value) * better.errors.get(name, math.nan)
        numbers[spec.name] = Estimate(value, (value - half, value + half), spec.unit(motion))
    return dataclasses.replace(
        f, effect=simplest.name(), form="", sentence=simplest.with_values(values).describe(motion), parameters=numbers,
        evidence={**f.evidence, "held_out_error_after": held}, equivalents=(), equivalent_errors={},
    )  # fmt: skip
