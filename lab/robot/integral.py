"""``python -m lab.robot.integral FILE.jsonl``: a three-joint arm, of whose servos one has integral action, beside arms without.

Half of the cases have ki between kp / 3 and 5 kp [1/s] at one joint; of the others every second has nothing that is missing but
numbers, the rest dry friction, a dead band, a delay or a velocity limit.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lab.real_use.score import Count
from lab.robot.sample import records, score_servo
from lab.robot.servo_cases import draw_servo, write_servo_case
from simgap.robot import diagnose_robot_files

__all__ = ["BLOCK", "main", "run_case", "table"]

BLOCK = (
    ("integral", ""), ("nothing", ""), ("integral", ""), ("single", "coulomb_friction"), ("integral", ""), ("parameters", ""),
    ("integral", ""), ("single", "time_delay"), ("integral", ""), ("nothing", ""), ("integral", ""), ("single", "servo_deadband"),
)  # fmt: skip
MISSES = 1.1  # times the reported held-out error


def run_case(number: int, seed: int, folder: Path) -> dict[str, Any]:
    """Make and diagnose one case in a folder; the score of `lab.robot.sample`, and of each joint the error of both engines."""
    kind, effect = BLOCK[number % len(BLOCK)]
    case = draw_servo(1000 * seed + number, kind, 3, effect)
    write_servo_case(case, folder)
    began = time.monotonic()
    d = diagnose_robot_files([folder / "a.csv"], folder / "arm.xml", folder / "out", [folder / "b.csv"])
    fits = {name: r.fit for name, r in d.joints.items()}
    return {
        "case": number, "seed": seed, "kind": kind, **score_servo(case, d), "seconds": round(time.monotonic() - began, 1),
        "mujoco_over_engine": {n: f["corrected"].held_out_rms / f["surrogate"].held_out_rms for n, f in fits.items()},
    }  # fmt: skip


def table(found: Sequence[dict[str, Any]]) -> str:
    """The score as Markdown."""
    integral, others = ([r for r in found if (r["kind"] == "integral") == own] for own in (True, False))
    near = [x <= MISSES for r in integral for x in r["mujoco_over_engine"].values()]
    rows = [
        ("integral action named at its joint, and nothing else", Count(sum(r["right"] for r in integral), len(integral))),
        ("other cases right", Count(sum(r["right"] for r in others), len(others))),
        ("cases with a false name", Count(sum(r["false_names"] > 0 for r in found), len(found))),
        (
            f"joints of arms with it: `corrected.xml` in MuJoCo within {MISSES} x of the engine's error",
            Count(sum(near), len(near)),
        ),
    ]
    errors = sorted(e for r in integral for e in r["relative_errors"])
    out = ["| measure | count | share | 95 % (Wilson) |", "|---|---|---|---|", *(f"| {name} | {c} |" for name, c in rows)]
    return "\n".join([*out, "", f"ki that was found: {', '.join(f'{100 * e:.1f}' for e in errors)} % off."]) + "\n"


def main() -> None:
    """Run the missing cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="JSON lines; cases that are there are not measured again")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=len(BLOCK))
    parser.add_argument("--cases", type=int, nargs="*", help="only these numbers of them")
    parser.add_argument("--keep", type=Path, help="keep the files of each case in this folder")
    a = parser.parse_args()
    done = {r["case"] for r in records(a.file) if r["seed"] == a.seed}
    for number in range(a.count):
        if number in done or (a.cases is not None and number not in a.cases):
            continue
        with TemporaryDirectory() as work:
            r = run_case(number, a.seed, Path(work) if a.keep is None else a.keep / f"{number:03d}")
        a.file.parent.mkdir(parents=True, exist_ok=True)
        with a.file.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(r) + "\n")
        print(r["case"], r["kind"], "ok" if r["right"] else "--", r["truth"], r["found"], r["verdict"], r["relative_errors"],
              {k: round(v, 3) for k, v in r["mujoco_over_engine"].items()}, f"{r['seconds']} s", flush=True)  # fmt: skip
    print(table([r for r in records(a.file) if r["seed"] == a.seed]))


if __name__ == "__main__":
    main()
