"""Rival arms that the diagnoses themselves hold: the refitted nominal model, and the lowest BIC with raw N."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from lab.benchmark.score import WITHOUT, CaseScore, score_case

__all__ = ["Arm", "bic_result", "refitted_result", "score_arms"]

Arm = tuple[str, str, list[CaseScore]]  # identifier, what it is, its scores


def refitted_result(result: Mapping[str, Any]) -> dict[str, Any]:
    """What somebody says who refits the nominal model and leaves it at that: never any physics."""
    fit = result.get("fit", {})
    verdict = result["verdict"] if result["verdict"] in WITHOUT else "parameters_only"
    return {**result, "verdict": verdict, "findings": [], "fit": {**fit, "corrected": fit.get("refitted", {})}}


def bic_result(result: Mapping[str, Any], rows: int) -> dict[str, Any] | None:
    """What BIC = N log(rms^2) + k log N names, N all rows of the recording, among the structures that were fitted."""
    fitted = [r for r in result.get("rivals", ()) if r["rms"] is not None and r["rms"] > 0]
    if not any(not r["effects"] for r in fitted):
        plain = {"effects": [], "parameters": len(result.get("linear_parameters", {})), **result["fit"]["refitted"]}
        fitted = [*fitted, plain]
    fitted = [r for r in fitted if r["rms"]]
    if not fitted or rows < 2:
        return None
    best = min(fitted, key=lambda r: rows * math.log(r["rms"] ** 2) + r["parameters"] * math.log(rows))
    found = [key.partition("@") for key in best["effects"]]
    findings = [{"effect": e, "place": p, "parameters": {}, "equivalents": []} for e, _, p in found]
    verdict = "missing_physics" if findings else refitted_result(result)["verdict"]
    fit = {**result["fit"], "corrected": {"held_out_rms": best.get("held_out_rms")}}
    return {**result, "verdict": verdict, "findings": findings, "fit": fit}


def score_arms(truths: Mapping[str, Mapping[str, Any]], results: Mapping[str, Mapping[str, Any]]) -> list[Arm]:
    """Each arm's scores on the cases that it can be told of; ``results`` carry ``rows``, the samples of the recording."""
    sound = {n: r for n, r in results.items() if "error" not in r}
    refitted = [score_case(n, truths[n], refitted_result(r)) for n, r in sound.items()]
    chosen: Sequence[tuple[str, dict[str, Any] | None]] = [(n, bic_result(r, int(r.get("rows", 0)))) for n, r in sound.items()]
    bic = [score_case(n, truths[n], r) for n, r in chosen if r is not None]
    return [
        ("refitted_nominal", "Nominal model refitted, no physics added", refitted),
        ("bic_raw_n", "Lowest BIC, every sample counted as independent", bic),
    ]
