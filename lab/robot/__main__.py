"""Measure the declared sample of concealed robots.

python -m lab.robot FILE.jsonl [--seed 4407] [--minutes 30] [--most N] [--even] [--kinds KIND...] [--table PAGE.md]
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from lab.robot.sample import markdown, records, run

MARKS = "<!-- sample: begin -->", "<!-- sample: end -->"


def main() -> None:
    """Run the missing cases, then print the table, and put it between the marks of a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="JSON lines; cases that are there are not measured again")
    parser.add_argument("--seed", type=int, default=4407)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--most", type=int, default=10**9, help="cases to measure now")
    parser.add_argument("--even", action="store_true", help="the kinds take turns")
    parser.add_argument("--kinds", nargs="+", default=(), help="only these kinds")
    parser.add_argument("--table", type=Path, help="a page with the marks of the table")
    a = parser.parse_args()
    for r in run(a.file, a.seed, a.minutes, a.most, a.even, a.kinds):
        print(
            r["case"],
            r.get("error") or f"{r['verdict']} truth {r['truth']} found {r['found']}",
            f"{r['wall_seconds']:.0f} s",
            flush=True,
        )
    text = markdown(records(a.file), a.kinds)
    print(text)
    if a.table:
        page = a.table.read_text(encoding="utf-8")
        own = tuple(m.replace("sample", f"sample {a.seed}") for m in MARKS)
        start, end = own if own[0] in page else MARKS
        head, tail = page[: page.index(start) + len(start)], page[page.index(end) :]
        a.table.write_text(f"{head}\n{text}\n{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
