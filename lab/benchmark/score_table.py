"""All cases together: the figures of ``benchmark.json``."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from lab.benchmark.cases import LEVELS
from lab.benchmark.catalogue import CATALOGUE
from lab.benchmark.grade import LIBRARY, SINGLE, bars, fraction
from lab.benchmark.power import PowerCurve, power_curve, power_curves, shares
from lab.benchmark.score import NULLS, CaseScore, Outcome, ParameterScore, score_case
from lab.benchmark.score_arms import Arm, score_arms

__all__ = ["SLOW", "summarise"]

SLOW = 30.0  # seconds that a diagnosis of 10 s at 2 kHz may take on two cores


def _rate(hits: Sequence[bool]) -> dict[str, Any]:
    value, interval = fraction(sum(hits), len(hits))
    return {"n": len(hits), "hits": int(sum(hits)), "share": value, "ci95": list(interval)}


def _median(values: Sequence[float]) -> float:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.median(finite)) if finite else float("nan")


def _seconds(cases: Sequence[CaseScore]) -> dict[str, float]:
    """How long diagnoses took; one that broke has no time."""
    took = [c.seconds for c in cases if np.isfinite(c.seconds)]
    return {
        "median": _median(took),
        "worst": max(took, default=0.0),
        "sum": float(sum(took)),
        "slow": sum(t > SLOW for t in took),
    }


def _level(cases: Sequence[CaseScore]) -> dict[str, Any]:
    numbers = [p for c in cases for p in c.parameters]
    return {
        "verdict": _rate([c.verdict_right for c in cases]),
        "right": _rate([c.outcome.good for c in cases]),
        "exact": _rate([c.outcome is Outcome.RIGHT for c in cases]),
        "named": _rate([c.named for c in cases]),
        "top1": _rate([c.top1 for c in cases if c.truth]),
        "place": _rate([right for c in cases for _, right in c.places]),
        "parameter_error": _median([p.error for p in numbers if p.counted]),
        "coverage": _rate([p.inside for p in numbers if p.inside is not None]),
        "gap_closed": _median([c.gap for c in cases]),
        "outcomes": dict(Counter(c.outcome.value for c in cases)),
        "seconds": _median([c.seconds for c in cases]),
    }


def _confusion(cases: Sequence[CaseScore]) -> dict[str, Any]:
    """Rows: what was concealed, one effect or none. Columns: the strongest finding, else the verdict."""
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for c in cases:
        if len(c.truth) > 1:
            continue
        row = c.truth[0].partition("@")[0] if c.truth else c.level
        column = c.found[0].partition("@")[0] if c.verdict == "missing_physics" and c.found else c.verdict
        table[row][column] += 1
    order = [*dict.fromkeys(e.effect for e in CATALOGUE)]
    rows = [*(r for r in order if r in table), *sorted(r for r in table if r not in order and r not in NULLS)]
    rows += [r for r in NULLS if r in table]
    met = {k for counts in table.values() for k in counts}
    columns = [*(e for e in order if e in met), *sorted(k for k in met if k not in order)]
    return {"rows": rows, "columns": columns, "counts": [[table[r][k] for k in columns] for r in rows]}


def _curve(cases: Sequence[CaseScore], seen: Callable[[CaseScore], bool]) -> dict[str, Any]:
    return _drawn(power_curve(*_sized(cases, seen)))


def _sized(cases: Sequence[CaseScore], seen: Callable[[CaseScore], bool]) -> tuple[list[float], list[bool]]:
    sized = [c for c in cases if c.size]
    return [c.size["after_refit"] for c in sized], [seen(c) for c in sized]


def _drawn(curve: PowerCurve) -> dict[str, Any]:
    drawn: dict[str, list[float]] = {}
    if not curve.note:
        x = np.geomspace(max(min(curve.sizes[0], curve.at50 / 5), 1e-3), max(curve.sizes[-1], 2 * curve.at90), 60)
        drawn = {"size": x.tolist(), "chance": curve.chance(x).tolist()}
    return {
        "n": len(curve.sizes), "seen": int(sum(curve.seen)), "at50": curve.at50, "at50_ci95": list(curve.at50_ci95),
        "at90": curve.at90, "at90_ci95": list(curve.at90_ci95), "slope": curve.slope, "note": curve.note,
        "cases": [[s, int(k)] for s, k in zip(curve.sizes, curve.seen, strict=True)],
        "curve": drawn, "bins": [asdict(b) for b in shares(curve.sizes, curve.seen)],
    }  # fmt: skip


def _power(cases: Sequence[CaseScore]) -> dict[str, Any]:
    """Detection and naming of single effects of the library, all together and one by one."""
    single = [c for c in cases if c.level in SINGLE]
    by: dict[str, list[CaseScore]] = defaultdict(list)
    for c in single:
        by[c.truth[0].partition("@")[0]].append(c)
    order = [e for e in dict.fromkeys(entry.effect for entry in CATALOGUE) if e in by]
    detected, named = (
        power_curves({e: _sized(by[e], seen) for e in order}) for seen in (lambda c: c.detected, lambda c: c.outcome.good)
    )
    return {
        "size": "rms change of the output that refitted linear parameters leave, over the noise rms",
        "detected": _curve(single, lambda c: c.detected),
        "named": _curve(single, lambda c: c.outcome.good),
        "by_effect": {e: {"detected": _drawn(detected[e]), "named": _drawn(named[e])} for e in order},
    }


def _numbers(parameters: Sequence[ParameterScore]) -> dict[str, Any]:
    counted = [p for p in parameters if p.counted]
    return {
        "n": len(counted),
        "median_error": _median([p.error for p in counted]),
        "worst_error": max((p.error for p in counted), default=float("nan")),
        "coverage": _rate([p.inside for p in parameters if p.inside is not None]),
    }


def _parameters(cases: Sequence[CaseScore]) -> dict[str, Any]:
    """Of effects of the library by the contract's law, named at their place; the linear parameters wherever a case is right."""
    library = [p for c in cases if c.level in LIBRARY and c.contract_law for p in c.parameters]
    effects = [e for e in dict.fromkeys(entry.effect for entry in CATALOGUE) if any(p.effect == e for p in library)]
    other = [p for c in cases if not c.contract_law for p in c.parameters]
    linear = [p for c in cases if c.outcome.good and c.level != "out_of_library" for p in c.linear]
    return {
        "all": _numbers(library),
        "by_effect": {e: _numbers([p for p in library if p.effect == e]) for e in effects},
        "other_law": _numbers(other),
        "linear": _numbers(linear),
    }


def _nulls(cases: Sequence[CaseScore]) -> dict[str, Any]:
    nulls = [c for c in cases if c.null]
    kinds = sorted({c.noise_kind for c in nulls})

    def alarms(some: Sequence[CaseScore]) -> dict[str, Any]:
        return _rate([c.verdict == "missing_physics" for c in some])

    return {
        "false_alarms": alarms(nulls),
        "unexplained": _rate([c.verdict == "unexplained" for c in nulls]),
        "by_level": {level: alarms([c for c in nulls if c.level == level]) for level in NULLS},
        "by_noise": {k: alarms([c for c in nulls if c.noise_kind == k]) for k in kinds},
        "closed_loop": alarms([c for c in nulls if c.closed_loop]),
    }


def _arm(identifier: str, what: str, cases: Sequence[CaseScore]) -> dict[str, Any]:
    library = [c for c in cases if c.level in LIBRARY]
    return {
        "id": identifier,
        "what": what,
        "verdict": _rate([c.verdict_right for c in cases]),
        "right": _rate([c.outcome.good for c in cases]),
        "plain": _rate([c.outcome.good for c in cases if c.level == "plain"]),
        "pairs": _rate([c.outcome.good for c in cases if c.level == "two_effects"]),
        "false_alarms": _rate([c.verdict == "missing_physics" for c in cases if c.null]),
        "out_of_library": _rate([c.verdict == "missing_physics" for c in cases if c.level == "out_of_library"]),
        "gap_closed": _median([c.gap for c in library]),
        "held_out_over_noise": _median([c.left.get("corrected", float("nan")) for c in library]),
    }


def summarise(truths: Mapping[str, Mapping[str, Any]], results: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Score every case that was diagnosed and put the figures together; see ``docs/decisions/benchmark.md``."""
    names = [n for n in truths if n in results]
    cases = [score_case(n, truths[n], results[n]) for n in names]
    arms: list[Arm] = [
        ("simgap", "The diagnosis", cases),
        *score_arms(truths, {n: results[n] for n in names}),
    ]
    judged = [c for c in cases if c.level != "faint"]  # those show where detection begins, and most of them are below it
    declared = [len(d) for c in cases for d in c.declared]
    return {
        "n": len(cases),
        "verdict": _rate([c.verdict_right for c in judged]),
        "right": _rate([c.outcome.good for c in judged]),
        "bars": [b.as_dict() for b in bars(cases)],
        "levels": {level: _level(some) for level in LEVELS if (some := [c for c in cases if c.level == level])},
        "nulls": _nulls(cases),
        "parameters": _parameters(cases),
        "power": _power(cases),
        "confusion": _confusion(cases),
        "equivalents_declared": {"findings": len(declared), "with_any": sum(d > 0 for d in declared),
                                 "mean": float(np.mean(declared)) if declared else 0.0},
        "arms": [_arm(*a) for a in arms],
        "rivals": None,
        "arms_missing": [],
        "seconds": _seconds(cases),
        "errors": {c.name: c.error for c in cases if c.error},
        "cases": [c.as_dict() for c in cases],
    }  # fmt: skip
