"""Run the cases that a file of records lacks, or score it."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.options import Options
from diagnose.verdict.numerics import IDS
from lab.real_use.firmware.design import ARM, SINGLE, Case, draw
from lab.real_use.firmware.machine import log_of, write_log
from lab.real_use.firmware.truth import machines
from lab.real_use.run import between_marks, measured, read, run_missing
from lab.real_use.score import Count
from mjsim.errors import InputError
from simgap.pipeline import diagnose_files
from simgap.robot import diagnose_robot_files

__all__ = ["line", "main", "run_case", "table", "write_files"]

BEGIN, END = "<!-- firmware: begin -->", "<!-- firmware: end -->"
CLEAN = ("no_mismatch", "parameters_only")
SECONDS = {500.0: 10.0, 200.0: 15.0}  # of a log; others have 20 s


def write_files(case: Case, folder: Path) -> tuple[list[tuple[str, str]], float]:
    """Write model.xml, estimation.csv and held_out.csv; truth of an arm's joints, rms by which the truth moves the angle."""
    given, true, where = machines(case)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(given.text(True), encoding="utf-8")
    seconds = SECONDS.get(case.rate, 20.0)
    for which, name in ((1, "estimation"), (2, "held_out")):
        command, angle, _ = log_of(case, true, which, seconds)
        write_log(folder / f"{name}.csv", case, true, command, angle)
    return where, float(np.sqrt(np.mean((angle - log_of(case, given, 2, seconds)[1]) ** 2)))


def run_case(case: Case, folder: Path, jobs: int) -> dict[str, Any]:
    """Make and diagnose one case in a folder."""
    where, moved = write_files(case, folder)
    out: dict[str, Any] = {**dataclasses.asdict(case), "where": where, "moved": moved, "exit": 0}
    files = [folder / f"{name}.csv" for name in ("estimation", "held_out")]
    with measured(out):
        try:
            if case.machine == "arm":
                diagnose_robot_files(files[:1], folder / "model.xml", folder / "out", files[1:])
            else:
                model, options = folder / "model.xml", Options(jobs=jobs)
                diagnose_files(files[:1], model, folder / "out", files[1:], options, progress=False, accept_log=True)
        except InputError as error:
            out |= {"exit": 2, "error": str(error)}
        except Exception:
            out |= {"exit": 1, "error": traceback.format_exc()}
    if not out["exit"]:
        d = json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))
        found = [f for f in d["findings"] if f["effect"] not in IDS]
        out |= {
            "verdict": d["verdict"], "found": sorted([f.get("joint") or "", f["effect"]] for f in found),
            "values": [[f.get("joint") or "", f["effect"], {k: v["value"] for k, v in f["parameters"].items()}] for f in found],
            "equivalents": sorted({e.split("@")[0] for f in found for e in f["equivalents"]}),
        }  # fmt: skip
    return out


def right(r: dict[str, Any]) -> bool:
    """Whether exactly the physics that is there is named, and the verdict agrees."""
    if r["exit"]:
        return False
    found, clean = [tuple(f) for f in r["found"]], r["verdict"] in CLEAN
    if r["moved"] == 0.0:  # what the machine has was not reached
        return clean and not found
    if r["machine"] == "arm":
        same = sorted(found) == sorted(map(tuple, r["where"]))
        return same and (clean if not r["where"] else r["verdict"] == "missing_physics")
    names = _names(r)
    return frozenset(names) in SINGLE[r["kind"]] and (clean if not names else r["verdict"] == "missing_physics")


def false(r: dict[str, Any]) -> bool:
    """Whether physics is named that is not there."""
    if r["exit"]:
        return False
    if r["machine"] == "arm":
        return bool({tuple(f) for f in r["found"]} - set(map(tuple, r["where"])))
    return all(bool(set(_names(r)) - names) for names in SINGLE[r["kind"]])


def clear(r: dict[str, Any]) -> bool:
    """Whether nothing is said to be missing although physics is."""
    missing = bool(ARM[r["kind"]]) if r["machine"] == "arm" else SINGLE[r["kind"]] != (frozenset(),)
    return not r["exit"] and missing and r["moved"] > 0.0 and r["verdict"] in CLEAN


def _names(r: dict[str, Any]) -> list[str]:
    """Effects of a joint; a stop at one end is one of the joint's."""
    return sorted({f[1].removeprefix("lower_").removeprefix("upper_") for f in r["found"]})


def line(r: dict[str, Any]) -> str:
    """A line for a case."""
    where = (
        f"{r['number']:3d} {r['machine']:9s} {r['rate']:3g} Hz {r['motion']:5s} {r['sensor']:7s} {r['way']:12s} {r['kind']:24s}"
    )
    if r["exit"]:
        return f"{where} -- {r['error'].strip().splitlines()[-1]}"
    values = ("".join((f"{j}." if j else "", e, "(", ", ".join(f"{x:.3g}" for x in v.values()), ")")) for j, e, v in r["values"])
    mark = "ok" if right(r) else "false name" if false(r) else "false all-clear" if clear(r) else "--"
    also = f" or {', '.join(r['equivalents'])}" if r["equivalents"] else ""
    return f"{where} moved {r['moved']:.2g} {mark}: {r['verdict']} {' + '.join(values) or '-'}{also}; {r['cpu_seconds']:.0f} s"


def table(records: Sequence[dict[str, Any]]) -> str:
    """The score as Markdown."""
    out = ["| measure | count | share | 95 % (Wilson) |", "|---|---|---|---|"]
    for title, group in (("one joint", [r for r in records if r["machine"] != "arm"]),
                         ("arms", [r for r in records if r["machine"] == "arm"])):  # fmt: skip
        if group:
            counts = [(name, Count(sum(map(holds, group)), len(group))) for name, holds in (
                ("right", right), ("a false name", false), ("a false all-clear", clear))]  # fmt: skip
            out += [f"| {title}: {name} | {count} |" for name, count in counts]
    wrong = [r for r in records if not right(r)]
    return "\n".join([*out, *(["", "Not right:", "", *(f"    {line(r)}" for r in wrong)] if wrong else [])]) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m lab.real_use.firmware", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="run the cases that the file of records lacks")
    run.add_argument("--seed", type=int, required=True)
    run.add_argument("--count", type=int, required=True)
    run.add_argument("--arms", action="store_true", help="arms of four joints in place of single joints")
    run.add_argument("--cases", type=int, nargs="*", help="only these numbers of them")
    run.add_argument("--kinds", nargs="*", choices=[*SINGLE, *ARM], help="only these kinds of them")
    run.add_argument("--jobs", type=int, default=1, help="threads")
    run.add_argument("--keep", type=Path, help="keep the files of each case in this folder")
    run.add_argument("--out", type=Path, required=True, help="file of records (JSON lines)")
    score = commands.add_parser("table", help="score records, as Markdown")
    score.add_argument("records", type=Path, nargs="+")
    score.add_argument("--into", type=Path, help="replace what stands between the two markers of this Markdown file")
    options = parser.parse_args(arguments)
    if options.command == "run":
        kinds = options.kinds or [*SINGLE, *ARM]
        drawn = [c for c in draw(options.count, options.seed, options.arms) if c.kind in kinds]
        cases = [c for c in drawn if options.cases is None or c.number in options.cases]
        for record in run_missing(cases, options.out, options.jobs, options.keep, run_case):
            print(line(record), flush=True)
        return 0
    records = [r for path in options.records for r in sorted(read(path).values(), key=lambda r: r["number"])]
    if options.into is None:
        print("\n".join([*map(line, records), "", table(records)]))
        return 0
    return between_marks(options.into, BEGIN, END, table(records))


if __name__ == "__main__":
    sys.exit(main())
