"""What was concealed beside what was found, line by line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from diagnose.report.figures import estimate, interval, number, percent, unit
from diagnose.report.words import effect_name, linear_name
from diagnose.result import Diagnosis, Estimate, Finding
from mjsim.effects import effect_class

__all__ = ["TruthRow", "truth_rows"]


@dataclass(frozen=True)
class TruthRow:
    """One line: what, the truth, what was found, its interval, how far off, and whether that is right (None: not to be said)."""

    what: str
    truth: str
    found: str
    interval: str
    off: str
    verdict: str
    right: bool | None
    part: bool = False


def truth_rows(d: Diagnosis, truth: Mapping[str, Any]) -> list[TruthRow]:
    """Effects first, concealed ones and invented ones, then the linear parameters.

    ``truth``: ``effects`` (identifiers), ``where`` {effect: place}, ``parameters`` {effect: {name: value}},
    ``linear_parameters`` {name: value}.
    """
    concealed: Sequence[str] = truth.get("effects", ())
    places: Mapping[str, str] = truth.get("where", {})
    values: Mapping[str, Mapping[str, float]] = truth.get("parameters", {})
    found = {f.effect: f for f in d.findings}
    rows: list[TruthRow] = []
    if not concealed and not found:
        rows.append(TruthRow("missing physics", "none", "none", "", "", "right", True))
    for effect in concealed:
        rows += _effect(d, effect, places.get(effect, ""), values.get(effect, {}), found.get(effect))
    rows += [
        TruthRow(effect_name(f.effect), "not there", f"found at the {f.place}", "", "", "invented", False)
        for f in d.findings
        if f.effect not in concealed
    ]
    for name, value in truth.get("linear_parameters", {}).items():
        e = d.linear_parameters.get(name)
        rows.append(_value(f"{linear_name(name, e.unit if e else '')} ({name})", name, float(value), e))
    return rows


def _effect(d: Diagnosis, effect: str, place: str, values: Mapping[str, float], f: Finding | None) -> list[TruthRow]:
    at = f"at the {place}" if place else "present"
    if f is None:
        near = [g for g in d.findings if effect in {name.partition("@")[0] for name in g.equivalents}]
        if near:
            found = f"named as what the data cannot tell from {effect_name(near[0].effect).lower()}"
            return [TruthRow(effect_name(effect), at, found, "", "", "left open", None)]
        return [TruthRow(effect_name(effect), at, "not found", "", "", "missed", False)]
    right = not place or place == f.place
    rows = [TruthRow(effect_name(effect), at, f"at the {f.place}", "", "", "right" if right else "other place", right)]
    return rows + [_value(name, name, float(v), f.parameters.get(name), effect) for name, v in values.items()]


def _value(what: str, name: str, truth: float, e: Estimate | None, effect: str = "") -> TruthRow:
    if e is None:
        return TruthRow(what, f"{number(truth)} {_unit(effect, name)}".strip(), "–", "", "", "not estimated", None, bool(effect))
    u = unit(e.unit)
    if name.startswith("phase") and e.unit == "rad":
        truth += 2 * math.pi * round((e.value - truth) / (2 * math.pi))
    low, high = e.ci95
    inside = low <= truth <= high
    off = percent(abs(e.value - truth) / abs(truth)) if truth else number(abs(e.value - truth))
    known = math.isfinite(low) and math.isfinite(high)
    verdict = "inside" if inside else "outside" if known else "not determined"
    return TruthRow(
        what,
        f"{number(truth)} {u}".strip(),
        f"{estimate(e)} {u}".strip(),
        interval(e),
        off,
        verdict,
        inside if known else None,
        bool(effect),
    )


def _unit(effect: str, name: str) -> str:
    """Unit of a parameter of a known effect, else nothing."""
    try:
        specs = {s.name: s.unit() for s in effect_class(effect).specs()}
    except KeyError:
        return ""
    return unit(specs.get(name, ""))
