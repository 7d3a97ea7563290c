"""Numerics as a cause: which setting of the user's simulator makes it differ from the equations, and what the data say of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.evidence.held_out import compare
from diagnose.fit.fitted import HeldOut
from diagnose.result import Finding
from diagnose.thresholds import BLOCKS, HORIZONS, NEARLY_ALL
from diagnose.verdict.reference import Case, Run, error, figures, judged
from diagnose.verdict.reference_runs import run_watched, too_far
from diagnose.verdict.reference_stage import APART, Nominal, apart
from mjsim.plant.settings import SETTINGS, Setting, mended

__all__ = ["IDS", "Cause", "cause_of", "finding", "gain_of", "note"]

IDS = tuple(s.id for s in SETTINGS)
REMOVED = math.sqrt(1 - NEARLY_ALL)  # of a difference that is left at most, for a setting to be its cause


@dataclass(frozen=True, eq=False)
class Cause:
    """The setting that makes a file differ from the equations, and by how much of the noise rms, as it is and mended."""

    setting: Setting
    element: str
    apart: float
    left: float


def cause_of(nominal: Nominal, threads: int) -> Cause | None:
    """The first setting whose mending removes the difference from the equations; None where none does.

    It is tried on the first part of the recordings that shows the difference: mended files take up to forty times the steps.
    """
    if nominal.apart <= APART:
        return None
    for part in HORIZONS[1::2]:
        cases = [c.first(math.ceil(part * len(c.measured))) for c in nominal.cases]
        runs, engine = ([_first(r, c) for r, c in zip(rs, cases, strict=True)] for rs in (nominal.runs, nominal.engine))
        shown = apart(cases, runs, engine)
        if min(nominal.apart, APART / REMOVED) <= shown < math.inf or part == HORIZONS[-1]:
            break
    starts = [case.start() if run is None else run.start for case, run in zip(cases, runs, strict=True)]
    limit = max(APART, REMOVED * shown if math.isfinite(shown) else APART)
    targets = [judged(c, r) for c, r in zip(cases, engine, strict=True) if r is not None]
    if len(targets) < len(cases):
        return None
    soft = any(b.softness for b in nominal.axis.chain.bodies)  # then the equations have the softness of the file
    for setting in SETTINGS:
        found = mended(nominal.plant.model, setting.id)
        if found is None or (soft and setting.id == "soft_friction"):
            continue
        model, edits = found
        plant = dataclasses.replace(nominal.plant, model=model)
        after, whole = run_watched(plant, cases, starts, threads, too_far(cases, targets, limit))
        if whole:
            element = next((name for kind, name, _, _ in edits if kind != "option"), nominal.plant.channels.joint)
            return Cause(setting, element, nominal.apart, apart(cases, after, engine))
    return None


def _first(run: Run | None, case: Case) -> Run | None:
    n = len(case.measured)
    return None if run is None else Run(run.velocity[:n], run.angle[:n], run.start)


def held_out_of(cases: Sequence[Case], runs: Sequence[Run | None]) -> HeldOut | None:
    """Held-out errors over the noise, in blocks; None where a run diverged."""
    errors, sse, count = [], [], []
    for case, run in zip(cases, runs, strict=True):
        if not case.held_out.any():
            continue
        if run is None:
            return None
        e = error(case, run)[case.held_out] / case.sigma
        errors.append(e)
        for part in np.array_split(e, BLOCKS):
            sse.append(float(part @ part))
            count.append(len(part))
    f = figures(cases, runs)
    return HeldOut(np.concatenate(errors), np.array(sse), np.array(count), f.held_out_rms, f.held_out_nrmse)


def gain_of(cases: Sequence[Case], before: Sequence[Run | None], after: Sequence[Run | None]) -> tuple[float, float]:
    """(relative fall of the held-out squared error, one-sided p-value over the settings that were tried)."""
    c = compare(held_out_of(cases, before), held_out_of(cases, after), known=True)
    return c.relative_gain, min(1.0, c.p_value * len(SETTINGS))


def finding(cause: Cause, place: str, before: float, after: float, p_value: float) -> Finding:
    """A finding of class numerics; errors: held-out rms of the file as it is, and mended.

    Its size is the difference from the equations that the setting makes, over the noise.
    """
    return Finding(
        effect=cause.setting.id, place=place, element=cause.element,
        sentence=f"{cause.setting.sentence} Mended, the model follows the recording; this is no physics.",
        parameters={},
        evidence={
            "held_out_error_before": before, "held_out_error_after": after, "p_value": p_value,
            "p_value_estimation": p_value, "hypotheses": float(len(SETTINGS)),
            "difference_over_noise": cause.apart, "difference_over_noise_mended": cause.left,
        },
        kind="numerics",
    )  # fmt: skip


def _soft_note(nominal: Nominal) -> str:
    """Note on soft friction that the recordings support and the search therefore has; empty where there is none."""
    if nominal.soft <= APART or not any(b.softness for b in nominal.axis.chain.bodies):
        return ""
    sentence = next(s.sentence for s in SETTINGS if s.id == "soft_friction")
    size = f"It moves the nominal file's run by {nominal.soft:.2g} times the noise."
    return f"{sentence} {size} The recordings agree with it; it is not physics."


def note(cause: Cause | None, nominal: Nominal) -> str:
    """Note on a difference between simulator and equations that is not a finding; empty where there is none."""
    if nominal.apart <= APART:
        return _soft_note(nominal)
    size = "diverges" if not math.isfinite(nominal.apart) else f"differs by {nominal.apart:.2g} times the noise"
    what = f": {cause.setting.sentence[0].lower()}{cause.setting.sentence[1:]}" if cause else "."
    whose = " The recordings bear it, so it is kept; it is no physics." if nominal.simulator else ""
    return f"The nominal file in plain MuJoCo {size} from the equations of motion{what}{whose}"
