"""``python -m lab.real_use run|table``: run the cases of a seed, resumably, one JSON line a case; score the lines.

python -m lab.real_use run --seed 7 --count 12 --out out/real_use/7.jsonl
python -m lab.real_use table out/real_use/7.jsonl
python -m lab.real_use files --seed 7 --case 5 --out out/case5
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from lab.real_use.design import draw
from lab.real_use.run import between_marks, read, run_case, run_missing, write_files
from lab.real_use.score import line, tables

__all__ = ["main"]


BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m lab.real_use", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="run the cases that the file of records lacks")
    run.add_argument("--seed", type=int, required=True)
    run.add_argument("--count", type=int, default=204, help="cases, from the first (default 204: 17 blocks)")
    run.add_argument("--cases", type=int, nargs="*", help="only these numbers of them")
    run.add_argument("--jobs", type=int, default=2, help="threads (default 2)")
    run.add_argument("--keep", type=Path, help="keep the files of each case in this folder")
    run.add_argument("--out", type=Path, required=True, help="file of records (JSON lines)")
    table = commands.add_parser("table", help="score records, as Markdown")
    table.add_argument("records", type=Path)
    table.add_argument("--into", type=Path, help="replace what stands between the two markers of this Markdown file")
    table.add_argument("--lines", action="store_true", help="a line for each case as well")
    files = commands.add_parser("files", help="write model and logs of one case")
    files.add_argument("--seed", type=int, required=True)
    files.add_argument("--case", type=int, required=True)
    files.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    if options.command == "files":
        write_files(draw(options.case + 1, options.seed)[options.case], options.out)
        return 0
    if options.command == "table":
        records = list(read(options.records).values())
        if options.into is not None:
            return between_marks(options.into, BEGIN, END, tables(records))
        print("\n".join([*map(line, records), ""] if options.lines else []) + tables(records))
        return 0
    cases = [c for c in draw(options.count, options.seed) if options.cases is None or c.number in options.cases]
    for record in run_missing(cases, options.out, options.jobs, options.keep, run_case):
        print(line(record), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
