"""``python -m lab.log_faults``: draw the cases, check each log and its control, print the score; exit 1 when a bar is missed."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from lab.log_faults.score import measure

__all__ = ["main"]


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m lab.log_faults", description=__doc__)
    parser.add_argument("--count", type=int, default=72, help="number of faulty logs; as many controls (default 72)")
    parser.add_argument("--seed", type=int, default=7301, help="seed of the cases (default 7301)")
    parser.add_argument("--out", type=Path, help="write the cases and the score as JSON")
    options = parser.parse_args()
    result = measure(options.count, options.seed, say=lambda line: print(line, flush=True))
    print(result.text())
    if options.out:
        options.out.write_text(json.dumps(result.as_dict(), indent=2) + "\n", encoding="utf-8")
    return 0 if result.holds() else 1


if __name__ == "__main__":
    sys.exit(main())
