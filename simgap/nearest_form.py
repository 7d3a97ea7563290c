"""A corrected file in whose place plain MuJoCo has something near what MJCF has no element for, and the file carries the rest.

MJCF's own elements then hold the nearest structure that they have (`Effect.nearest`), its numbers refitted in MuJoCo, and the
carried text holds what was found, for simgap. Where no such structure follows the recordings as well as the file as given does,
MuJoCo gets the file as given.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from diagnose.verdict.reference import Case, Run, chi_square
from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mjcf.adjust import carry
from mjsim.mjcf.faithful import Faithful, nearest_native
from simgap.bench import Bench

__all__ = ["with_nearest"]

Form = tuple[Faithful, Sequence[Run | None]]
AS_GIVEN = (
    "In corrected.xml, plain MuJoCo has the model as given: MJCF has no element for what was found, and nothing near it follows "
    "the recordings better. What was found is carried for simgap replay."
)


def with_nearest(
    bench: Bench, form: Faithful, runs: Sequence[Run | None], settle: Callable[[Bench], Form]
) -> tuple[Faithful, Sequence[Run | None], tuple[str, ...]]:
    """The form of ``bench.out``, its runs, and a note on what MJCF's elements have in place of what they lack.

    ``settle`` writes an axis in the form that MuJoCo steps as its equations say and refits its numbers. Of the form as it is and
    the nearest structure, the one of the smaller chi-square on the estimation data counts; the file as given where that is
    larger than its own there or on the held-out data. ``bench.out`` is rewritten.
    """
    if not form.lacks:
        return form, runs, ()
    out, cases, nominal = bench.out, bench.nominal.cases, bench.nominal
    carried = load_model(out, bound={}).carried
    lacks = carried.lacks if carried is not None else ()
    native = nearest_native(bench.axis, {key for key, _ in lacks}, _speed(cases))
    trial = out.with_name(f".{out.stem}.nearest.part.xml")
    note: tuple[str, ...] = ()
    try:
        with contextlib.suppress(InputError, ValueError):
            other, after = settle(dataclasses.replace(bench, axis=native, out=trial))
            if not other.lacks and _chi2(cases, after) < _chi2(cases, runs):
                note = _in_place(bench.axis, load_axis(trial))
                carry(trial, bench.axis, lacks, " ".join(note))
                trial.replace(out)
                form, runs = dataclasses.replace(other, lacks=form.lacks), after
    finally:
        trial.unlink(missing_ok=True)
    if all(_chi2(cases, runs, part) <= _chi2(cases, nominal.runs, part) for part in ("estimation", "held_out")):
        return form, runs, note
    write_corrected(bench.model, bench.given, out)
    carry(out, bench.axis, lacks, AS_GIVEN)
    return dataclasses.replace(form, form="as given"), nominal.runs, (AS_GIVEN,)


def _chi2(cases: Sequence[Case], runs: Sequence[Run | None], part: str = "estimation") -> float:
    return chi_square(cases, runs, part)[0]


def _speed(cases: Sequence[Case]) -> float:
    """Rms speed over all recordings [rad/s | m/s]."""
    speeds = [np.gradient(c.measured, c.recording.dt) if c.servo else c.measured for c in cases]
    return math.sqrt(float(np.mean(np.concatenate(speeds) ** 2)))


def _in_place(found: Axis, native: Axis) -> tuple[str, ...]:
    """A note on what a file's own elements have otherwise than the axis that it carries; none where that is nothing."""
    motion, there = native.chain.motion, {e.key for e in found.effects}
    parts = [e.describe(motion).rstrip(".") for e in native.effects if e.key not in there]
    now = {p.name: p.value for p in found.chain.linear_parameters()}
    parts += [
        f"{p.name} {now[p.name]:.5g} -> {p.value:.5g} {p.quantity.unit(motion)}"
        for p in native.chain.linear_parameters()
        if p.name in now and not math.isclose(p.value, now[p.name], rel_tol=1e-6, abs_tol=1e-12)
    ]
    said = (
        f"In corrected.xml, plain MuJoCo has in place of what MJCF lacks, refitted in MuJoCo: {'; '.join(parts)}. What was found "
        "is carried for simgap replay."
    )
    return (said,) if parts else ()
