"""Rival arms beside the diagnosis on the same cases: held-out errors over the noise and over the refit, and who cries wolf.

Plain values on both sides: what an arm wrote down (``held_out_rms``, ``refitted_rms``, ``noise_gain``, ``named``, ``seconds``, or
``error``), and the truth from the envelope.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lab.benchmark.cases import LEVELS
from lab.benchmark.grade import LIBRARY, fraction
from lab.benchmark.score import NULLS, score_case

__all__ = ["first_cases", "score_rivals"]

FLAT = ("white", "quantised")  # noise whose level after a filter is known: steps below the noise add white noise


def first_cases(truths: Mapping[str, Mapping[str, Any]], most: int) -> list[str]:
    """The first ``most`` cases of each level, by number; the numbers are shuffled, so this is a draw."""
    out: list[str] = []
    for level in LEVELS:
        out += sorted(n for n, t in truths.items() if t["level"] == level)[:most]
    return sorted(out)


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _median(values: Sequence[float]) -> float:
    finite = [v for v in values if math.isfinite(v)]
    return float(np.median(finite)) if finite else math.nan


def _rate(hits: Sequence[bool]) -> dict[str, Any]:
    value, interval = fraction(sum(hits), len(hits))
    return {"n": len(hits), "hits": int(sum(hits)), "share": value, "ci95": list(interval)}


def _of_diagnosis(result: Mapping[str, Any]) -> dict[str, Any]:
    """The diagnosis as one arm among others."""
    if "error" in result:
        return {"error": result["error"], "seconds": None}
    fit = result.get("fit", {})
    named = [f"{f['effect']}@{f['place']}" for f in result["findings"]] if result["verdict"] == "missing_physics" else []
    return {
        "held_out_rms": fit.get("corrected", {}).get("held_out_rms"),
        "refitted_rms": fit.get("refitted", {}).get("held_out_rms"),
        "noise_gain": 1.0, "named": named, "seconds": result.get("seconds"),
    }  # fmt: skip


def _over_noise(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> float:
    """Held-out error over the noise that passes the arm's filter; nan where that is not known (coloured noise, filtered)."""
    gain = _number(answer["noise_gain"])
    if gain != 1.0 and truth.get("noise_kind", "white") not in FLAT:
        return math.nan
    return _number(answer["held_out_rms"]) / (gain * float(truth["velocity_noise_rms_rad_s"]))


def _ratios(truths: Mapping[str, Mapping[str, Any]], answers: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    sound = {n: a for n, a in answers.items() if "error" not in a}
    over_refit = [_number(a["held_out_rms"]) / _number(a["refitted_rms"]) for a in sound.values()]
    return {
        "n": len(sound),
        "over_noise": _median([_over_noise(truths[n], a) for n, a in sound.items()]),
        "over_refitted": _median(over_refit),
    }


def _right(truth: Mapping[str, Any], name: str, result: Mapping[str, Any], named: Sequence[str]) -> bool:
    """Whether effects that were named without equivalents are those concealed, scored as a diagnosis is."""
    findings = [
        {"effect": e, "place": p, "parameters": {}, "equivalents": []} for e, _, p in (key.partition("@") for key in named)
    ]
    verdict = "missing_physics" if findings else "no_mismatch"
    return score_case(name, truth, {**result, "verdict": verdict, "findings": findings}).outcome.good


def _row(
    about: Mapping[str, Any], truths: Mapping[str, Mapping[str, Any]], results: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    answers: Mapping[str, Mapping[str, Any]] = about["answers"]
    sound = {n: a for n, a in answers.items() if "error" not in a}
    by = {level: {n: a for n, a in answers.items() if truths[n]["level"] == level} for level in LEVELS}
    alarms = [bool(sound[n]["named"]) for n in sound if truths[n]["level"] in NULLS]
    library = [n for n in sound if truths[n]["level"] in LIBRARY]
    right = [
        _right(truths[n], n, results[n], sound[n]["named"])
        for n in library
        if about["names"] == "effects" and "error" not in results[n]
    ]
    return {
        **{k: about[k] for k in ("id", "what", "names", "skipped")},
        "levels": {level: _ratios(truths, some) for level, some in by.items() if some},
        "all": _ratios(truths, answers),
        "false_alarms": _rate(alarms) if about["names"] else None,
        "claimed": _rate([bool(sound[n]["named"]) for n in library]) if about["names"] else None,
        "right": _rate(right) if about["names"] == "effects" else None,
        "seconds": _median([_number(a.get("seconds")) for a in answers.values()]),
        "failed": {n: a["error"] for n, a in answers.items() if "error" in a},
        "answers": dict(answers),
    }


def score_rivals(
    truths: Mapping[str, Mapping[str, Any]],
    results: Mapping[str, Mapping[str, Any]],
    names: Sequence[str],
    ran: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """The table of ``benchmark.json``: the diagnosis and each arm on the cases ``names``.

    Held-out errors as medians, by level and over all; where an arm names something, its false alarms on the nulls with their
    Clopper-Pearson interval, the share of library cases in which it says that something is missing, and for effects how often
    it names the right ones (no equivalents: the diagnosis's own, which may declare some, are scored in the levels above).
    """
    own = {
        "id": "simgap", "what": "The diagnosis", "names": "effects", "skipped": "",
        "answers": {n: _of_diagnosis(results[n]) for n in names},
    }  # fmt: skip
    return {
        "cases": list(names),
        "levels": [level for level in LEVELS if any(truths[n]["level"] == level for n in names)],
        "arms": [_row(about, truths, results) for about in (own, *ran)],
    }
