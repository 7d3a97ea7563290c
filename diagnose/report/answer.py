"""The head of a diagnosis page: the answer in one sentence, and the figures that bear it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from diagnose.report.figures import number, p_value, percent, unit
from diagnose.result import Diagnosis, FitFigures

__all__ = ["Tile", "false_alarm", "sentences", "tiles"]


@dataclass(frozen=True)
class Tile:
    """A figure of the head: the number, what it is, and a detail."""

    figure: str
    what: str
    detail: str


def sentences(summary: str) -> tuple[str, str]:
    """The first sentence of a summary, and the rest."""
    first, *rest = re.split(r"(?<=[.!?])\s+(?=[A-Z])", summary.strip(), maxsplit=1)
    return first, rest[0] if rest else ""


def tiles(d: Diagnosis) -> list[Tile]:
    """Errors of the files on held-out and on estimation data, in units of the noise, and the evidence."""
    out = [t for part, name in (("held_out_rms", "held-out"), ("rms", "estimation")) if (t := _errors(d, part, name))]
    best = d.fit.get("corrected") or d.fit.get("refitted")
    if best and d.noise_floor > 0 and math.isfinite(best.held_out_rms):
        detail = f"{number(best.held_out_rms, 3)} against {number(d.noise_floor, 3)} {unit(d.unit)} rms on held-out data"
        if d.findings and d.gap_closed > 0:
            detail += f"; the findings remove {percent(d.gap_closed)} of what the refitted model misses above it"
        out.append(Tile(f"{number(best.held_out_rms / d.noise_floor, 3)} ×", "the noise: remaining error", detail))
    out.append(_evidence(d))
    return out


def _errors(d: Diagnosis, part: str, name: str) -> Tile | None:
    """nominal -> corrected on one kind of data."""
    before, after = (_rms(d.fit.get(key), part) for key in ("nominal", "corrected"))
    if before is None or after is None:
        return None
    u = unit(d.unit)
    ran = " (it diverges)" if math.isinf(before) else ""
    by = "both files stepped by MuJoCo" if d.surrogate else "both by the fitting engine"
    what = f"{u} rms error on {name} data"
    if before == after:
        return Tile(number(after, 3), what, f"model as given = corrected.xml; {by}")
    return Tile(f"{number(before, 3)} → {number(after, 3)}", what, f"model as given{ran} → corrected.xml; {by}")


def _rms(f: FitFigures | None, part: str) -> float | None:
    value = getattr(f, part) if f is not None else math.nan
    return None if math.isnan(value) else value


def _evidence(d: Diagnosis) -> Tile:
    worst = max((f.evidence["p_value"] for f in d.findings if "p_value" in f.evidence), default=None)
    if worst is not None:
        tested = max((f.evidence.get("hypotheses", 0) for f in d.findings), default=0)
        detail = "chance of such a gain on held-out data with nothing missing, corrected for " + (
            f"{tested:.0f} hypotheses" if tested else "all hypotheses"
        )
        return Tile(p_value(worst), "p-value" + ("" if len(d.findings) == 1 else ", weakest finding"), detail)
    others = sum(bool(r.effects) for r in d.rivals)
    what = "richer structure fitted" if others == 1 else "richer structures fitted"
    detail = "none better on held-out data" if others else "none promised a gain worth a fit"
    return Tile(f"{others}", what, detail + (f", of {d.hypotheses} hypotheses" if d.hypotheses else ""))


def false_alarm(d: Diagnosis) -> str:
    """How often physics is named where none is missing, in one sentence; empty where it was not measured."""
    a = d.false_alarm
    if not a:
        return ""
    return (
        f"In {a['alarms']:.0f} of {a['recordings']:.0f} simulated recordings with nothing missing, physics was named "
        f"all the same: {percent(a['share'])} (95 % interval {percent(a['low'])} to {percent(a['high'])})."
    )
