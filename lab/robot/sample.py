"""A concealed sample of robots that is declared beforehand: draw, diagnose, score, one JSON line a case.

The plan is a shuffled list, so that the cases of a run that is cut short are a random part of it. A run goes on where
the file ends.
"""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.result import Estimate
from diagnose.robot.result import RobotDiagnosis, RobotFinding
from diagnose.robot.servos.library import DELAY
from lab.real_use.score import Count
from lab.robot.cases import draw
from lab.robot.measure import one as one_by_force
from lab.robot.servo_cases import LATE, ServoCase, draw_servo, write_servo_case

__all__ = ["PLAN", "Item", "markdown", "plan", "run", "score_servo"]

PLAN: Mapping[tuple[str, str], int] = {  # cases of each kind on each of the two arms
    ("servo", "nothing"): 18, ("servo", "parameters"): 12, ("servo", "single"): 18, ("servo", "pair"): 9, ("servo", "skew"): 6,
    ("servo", "coupled"): 6, ("servo", "compensation"): 3, ("servo", "integral"): 3,
    ("torque", "nothing"): 12, ("torque", "parameters"): 6, ("torque", "single"): 6, ("torque", "pair"): 6,
    ("torque", "compensation"): 3, ("torque", "steady_load"): 3, ("torque", "cable"): 3, ("torque", "flexible"): 3,
}  # fmt: skip
ARMS = (3, 6)
CHANGED = 0.1  # relative change above which a number is the one that a case has changed


@dataclass(frozen=True)
class Item:
    """One planned case."""

    plant: str
    kind: str
    axes: int
    number: int

    @property
    def key(self) -> str:
        """Name of the case in the file."""
        return f"{self.plant}-{self.kind}-{self.axes}-{self.number}"


def plan(seed: int, even: bool = False) -> list[Item]:
    """All cases, in an order that is drawn from the seed; ``even``: the kinds take turns, each in that order."""
    items = [Item(p, k, a, n) for (p, k), count in PLAN.items() for a in ARMS for n in range(count)]
    drawn = [items[i] for i in np.random.default_rng(seed).permutation(len(items))]
    if not even:
        return drawn
    turns: dict[tuple[str, str], int] = dict.fromkeys(PLAN, 0)
    keyed = []
    for item in drawn:
        kind = item.plant, item.kind
        keyed.append((turns[kind], list(PLAN).index(kind), item))
        turns[kind] += 1
    return [item for _, _, item in sorted(keyed, key=lambda x: x[:2])]


def _name(f: RobotFinding) -> str:
    """The effect, or that the positions of the joint are logged late."""
    return LATE if f.effect == DELAY and f.place == "sensor" else f.effect


def _equivalents(f: RobotFinding) -> set[str]:
    """Names that a finding cannot be told from; a delay that is an equivalent of a delay is one of the log, or of the servo."""
    other = {LATE, DELAY} if f.effect == DELAY and DELAY in f.equivalents else set()
    return (set(f.equivalents) | other) - {_name(f)}


def score_servo(case: ServoCase, d: RobotDiagnosis) -> dict[str, Any]:
    """Names, verdict, relative errors of the values, intervals that hold the truth, and the part of the held-out closed-loop
    error at the joints with an effect that corrected.xml takes away.
    """
    expected = case.expected
    found = {(_name(f), f.joint): f for f in d.findings}
    errors, held = [], []
    for key, values in case.truth.items():
        for name, value in values.items() if key in found else ():
            e = found[key].parameters[name]
            errors.append(abs(e.value - value) / abs(value))
            held.append(e.ci95[0] <= value <= e.ci95[1])
    alike = all(k in found or any(f.joint == k[1] and k[0] in _equivalents(f) for f in d.findings) for k in expected)
    fits = [d.joints[j].fit for _, j in expected if j in d.joints]
    numbers = _numbers(case, d) if case.kind == "parameters" else []
    return {
        "truth": sorted(f"{e}@{j}" for e, j in expected), "parameters": list(case.parameters),
        "found": sorted(f"{e}@{j}" for e, j in found), "verdict": d.verdict.value,
        "verdicts": {j: r.verdict.value for j, r in d.joints.items()}, "right": set(found) == expected,
        "right_or_equivalent": alike and len(found) == len(expected), "false_names": len(set(found) - expected),
        "relative_errors": errors, "intervals_hold": held, "changed": list(d.changed),
        "number_errors": [abs(e.value - v) / v for e, v in numbers],
        "numbers_hold": [e.ci95[0] <= v <= e.ci95[1] for e, v in numbers],
        "gap_closed": [1 - f["corrected"].held_out_rms / f["nominal"].held_out_rms for f in fits],
    }  # fmt: skip


def _numbers(case: ServoCase, d: RobotDiagnosis) -> list[tuple[Estimate, float]]:
    """(estimate, truth) of the gains and armatures that changed by more than `CHANGED`, and of the mass that changed.

    Where the diagnosis gives no mass, its estimate is that of the file.
    """
    out = []
    for j, (servo, true) in enumerate(zip(case.nominal.servos, case.true.servos, strict=True)):
        own = d.joints[f"joint{j + 1}"].linear_parameters
        rotor, was = case.true.arm.links[j].rotor, case.nominal.arm.links[j].rotor
        out += [(own["kp"], true.kp)] if abs(true.kp / servo.kp - 1) > CHANGED else []
        out += [(own["armature"], rotor)] if abs(rotor / was - 1) > CHANGED else []
    for link, given in zip(case.true.arm.links, case.nominal.arm.links, strict=True):
        if link.mass != given.mass:
            mass, more = d.links.get(f"{link.name}.mass"), d.links.get(f"{link.name}.payload")
            file = Estimate(given.mass, (given.mass, given.mass), "kg")
            out.append((more, link.mass - given.mass) if mass is None and more is not None else (mass or file, link.mass))
    return out


def _measured(item: Item, seed: int, folder: Path) -> dict[str, Any]:
    from simgap.robot import diagnose_robot_files

    number = 1000 * seed + item.number
    if item.plant == "torque":
        return one_by_force(draw(number, item.kind, item.axes), folder)
    case = draw_servo(number, item.kind, item.axes)
    write_servo_case(case, folder)
    d = diagnose_robot_files([folder / "a.csv"], folder / "arm.xml", folder / "out", [folder / "b.csv"])
    return score_servo(case, d)


def records(path: Path) -> list[dict[str, Any]]:
    """The lines of a file; one that was cut off is left out."""
    out = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            out.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return out


def run(
    path: Path, seed: int, minutes: float = math.inf, most: int = 10**9, even: bool = False, kinds: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Measure the cases that the file lacks, for so long or so many; each is appended when it is scored, and given.

    kinds: those that are measured, all when empty.
    """
    done, ends = {r["case"] for r in records(path)}, time.monotonic() + 60 * minutes
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not path.read_bytes().endswith(b"\n"):
        path.write_bytes(path.read_bytes()[: path.read_bytes().rfind(b"\n") + 1])
    for item in [x for x in plan(seed, even) if x.key not in done and (not kinds or x.kind in kinds)][:most]:
        if time.monotonic() > ends:
            return
        begun, folder = time.monotonic(), path.parent / item.key
        try:
            record = _measured(item, seed, folder)
        except Exception as error:  # a crash is a result as well: it counts as not right
            record = {"error": f"{type(error).__name__}: {error}"}
        record |= {
            "case": item.key,
            "plant": item.plant,
            "kind": item.kind,
            "axes": item.axes,
            "wall_seconds": time.monotonic() - begun,
        }
        with path.open("a", encoding="utf-8") as f:
            f.write(json.dumps(record) + "\n")
        shutil.rmtree(folder, ignore_errors=True)
        yield record


def _right(r: Mapping[str, Any]) -> bool:
    """Names and no other; where only numbers differ, the verdict as well."""
    if r["kind"] == "parameters":
        return not r["found"] and r["verdict"] == "parameters_only"
    return bool(r["right"]) and (r["kind"] != "nothing" or r["verdict"] == "no_mismatch")


def markdown(found: Sequence[Mapping[str, Any]], kinds: Sequence[str] = ()) -> str:
    """The table, with Wilson's intervals, and the number of planned cases that are missing; kinds: planned ones, all if empty."""
    lines = [
        "| plant | kind | measured of planned | all right | or an equivalent name | with a false name |",
        "|---|---|---|---|---|---|",
    ]
    planned = {key: count for key, count in PLAN.items() if not kinds or key[1] in kinds}
    for (plant, kind), count in planned.items():
        own = [r for r in found if (r["plant"], r["kind"]) == (plant, kind)]
        good = [r for r in own if "error" not in r]
        alike = sum(_right(r) or (kind not in ("nothing", "parameters") and r["right_or_equivalent"]) for r in good)
        cells = (sum(map(_right, good)), alike, sum(r["false_names"] > 0 for r in good))
        texts = [f"{n} ({_interval(n, len(own))})" for n in cells]
        lines.append(f"| {plant} | {kind} | {len(own)} of {count * len(ARMS)} | {' | '.join(texts)} |")
    errors = [e for r in found for e in r.get("relative_errors", ())]
    held = [h for r in found for h in r.get("intervals_hold", ())]
    gaps = [g for r in found for g in r.get("gap_closed", ())]
    total, failed = sum(planned.values()) * len(ARMS), sum("error" in r for r in found)
    lines += [
        "",
        f"{len(found)} of {total} planned cases are measured, {total - len(found)} are missing; {failed} ended with an error.",
    ]
    if errors:
        share = f"{sum(held)} of {len(held)} ({_interval(sum(held), len(held))})"
        middle = 100 * float(np.median(errors))
        lines.append(f"Median relative error of the values {middle:.2g} %; the 95 % intervals hold the truth in {share}.")
    numbers = [e for r in found for e in r.get("number_errors", ())]
    if numbers:
        told = [bool(h) for r in found for h in r.get("numbers_hold", ())]
        share = f"{sum(told)} of {len(told)} ({_interval(sum(told), len(told))})"
        middle = 100 * float(np.median(numbers))
        lines.append(f"Median relative error of the changed numbers {middle:.2g} %; the intervals hold the truth in {share}.")
    if gaps:
        lines.append(
            f"Median part of the held-out closed-loop error that corrected.xml takes away: {float(np.median(gaps)):.3f}."
        )
    return "\n".join(lines)


def _interval(hits: int, of: int) -> str:
    low, high = Count(hits, of).interval
    return f"{100 * low:.0f} to {100 * high:.0f} %"
