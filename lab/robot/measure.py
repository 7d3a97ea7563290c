"""Measure the diagnosis of concealed robots: draw, write logs, diagnose, open, score.

python -m lab.robot.measure OUT --seed 5101 --each 5
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.robot.result import RobotDiagnosis
from lab.robot.cases import KINDS, Case, draw, write_log

__all__ = ["interval", "main", "score"]

PHASES = ("phase_rad",)


def score(case: Case, d: RobotDiagnosis) -> dict[str, Any]:
    """What was right: names (joint and effect, all and no other), values (relative errors), and how many intervals hold the
    truth."""
    true = {(law.id, f"joint{law.joint + 1}"): law.values for law in case.laws}
    found = {(f.effect, f.joint): f for f in d.findings}
    errors, held = [], []
    for key, values in true.items():
        if key in found:
            for name, value in values.items():
                e = found[key].parameters[name]
                errors.append(abs(e.value - value) / abs(value))
                held.append(e.ci95[0] <= value <= e.ci95[1])
    told = all(key in found or any(f.joint == key[1] and key[0] in f.equivalents for f in d.findings) for key in true) and len(
        found
    ) == len(true)
    return {
        "kind": case.kind, "axes": len(case.nominal.links), "seed": case.seed, "truth": [f"{e}@{j}" for e, j in true],
        "parameters": list(case.parameters), "found": [f"{e}@{j}" for e, j in found], "verdict": d.verdict.value,
        "right": set(found) == set(true), "right_or_equivalent": told, "false_names": len(set(found) - set(true)),
        "relative_errors": errors, "intervals_hold": held, "seconds": d.seconds, "changed": list(d.changed),
        "held_out": {k: f.held_out_nrmse for k, f in d.fit.items()},
    }  # fmt: skip


def interval(right: int, of: int) -> tuple[float, float]:
    """95 % interval of a share (C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404)."""
    from scipy.stats import beta

    low = 0.0 if right == 0 else float(beta.ppf(0.025, right, of - right + 1))
    high = 1.0 if right == of else float(beta.ppf(0.975, right + 1, of - right))
    return low, high


def one(case: Case, folder: Path) -> dict[str, Any]:
    """Diagnose one case from its files alone, and score it."""
    from simgap.robot import diagnose_robot_files

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(case.nominal.mjcf("arm"), encoding="utf-8")
    for index, name in enumerate(("a.csv", "b.csv")):
        write_log(case, folder / name, index)
    d = diagnose_robot_files([folder / "a.csv"], folder / "arm.xml", folder / "out", [folder / "b.csv"])
    return score(case, d)


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Shares with their intervals, by kind; errors and coverage over all that was found right."""
    out: dict[str, Any] = {}
    for kind in KINDS:
        own = [r for r in results if r["kind"] == kind]
        if own:
            right = sum(r["right"] for r in own)
            out[kind] = {"cases": len(own), "right": right, "ci95": interval(right, len(own)),
                         "right_or_equivalent": sum(r["right_or_equivalent"] for r in own),
                         "false_names": sum(r["false_names"] for r in own)}  # fmt: skip
    errors = [e for r in results for e in r["relative_errors"]]
    held = [h for r in results for h in r["intervals_hold"]]
    if errors:
        out["values"] = {"median_relative_error": float(np.median(errors)), "intervals_hold": sum(held), "of": len(held),
                         "ci95": interval(sum(held), len(held))}  # fmt: skip
    out["seconds"] = {"median": float(np.median([r["seconds"] for r in results])), "largest": max(r["seconds"] for r in results)}
    return out


def main() -> None:
    """Run the cases of a seed; results are written as they come."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=5101)
    parser.add_argument("--each", type=int, default=5, help="cases of each kind on each arm")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    results: list[dict[str, Any]] = []
    for k in range(arguments.each):
        for kind in KINDS:
            for axes in (3, 6):
                begun = time.perf_counter()
                case = draw(1000 * arguments.seed + k, kind, axes)
                results.append(one(case, arguments.out / f"{kind}_{axes}_{k}"))
                results[-1]["wall_seconds"] = time.perf_counter() - begun
                (arguments.out / "results.json").write_text(json.dumps({"summary": summary(results), "cases": results}, indent=1))
    print(json.dumps(summary(results), indent=1))


if __name__ == "__main__":
    main()
