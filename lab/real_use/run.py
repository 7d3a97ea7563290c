"""One case: its files, its diagnosis, and what is recorded of both."""

from __future__ import annotations

import dataclasses
import json
import resource
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Protocol, TypeVar

from diagnose.options import Options
from diagnose.verdict.numerics import IDS
from lab.real_use.design import Case
from lab.real_use.logs import Log, extent, follow, make
from lab.real_use.machines import Numbers, nominal, text, true_numbers
from mjsim.errors import InputError
from simgap.pipeline import diagnose_files

__all__ = ["between_marks", "measured", "read", "run_case", "run_missing", "said", "write_files"]

Record = dict[str, Any]


class Numbered(Protocol):
    """A case by its number, a dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def number(self) -> int:
        """Its number in the design."""


C = TypeVar("C", bound=Numbered)


def write_files(case: Case, folder: Path) -> tuple[Numbers, Numbers, list[Log]]:
    """Write nominal.xml, true.xml, estimation.csv and held_out.csv; numbers of both files, and the two logs."""
    given = nominal(case)
    truth = true_numbers(case, given, extent(case, text(case, given), given))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "nominal.xml").write_text(text(case, given), encoding="utf-8")
    (folder / "true.xml").write_text(text(case, truth), encoding="utf-8")
    logs = [make(case, text(case, truth), given, which) for which in (1, 2)]
    for log, name in zip(logs, ("estimation", "held_out"), strict=True):
        log.write(folder / f"{name}.csv")
    return given, truth, logs


def run_case(case: Case, folder: Path, jobs: int) -> Record:
    """Make and diagnose one case in a folder. ``error`` is a message (exit code 2) or a traceback (exit code 1).

    ``refused``: what the check of the log calls faults to be fixed first; such a log is accepted then, as a user does who knows
    its clocks.
    """
    given, truth, (_, held) = write_files(case, folder)
    changed = {
        f.name: getattr(truth, f.name) for f in dataclasses.fields(truth) if getattr(truth, f.name) != getattr(given, f.name)
    }
    out: Record = {
        **dataclasses.asdict(case), "truth": changed, "noise": held.noise,
        "given_error": follow(folder / "nominal.xml", case.rate, held),
        "true_error": follow(folder / "true.xml", case.rate, held),
    }  # fmt: skip
    with measured(out):
        try:
            files = [folder / f"{name}.csv" for name in ("estimation", "held_out")]
            diagnose = partial(
                diagnose_files, files[:1], folder / "nominal.xml", folder / "out", files[1:], Options(jobs=jobs), progress=False
            )
            log = diagnose().log
            out["refused"] = [] if log is None else sorted({p.problem for p in log.to_fix()})
            if out["refused"]:
                diagnose(accept_log=True)
            out["exit"] = 0
        except InputError as error:
            out |= {"exit": 2, "error": str(error)}
        except Exception:
            out |= {"exit": 1, "error": traceback.format_exc()}
    if out["exit"] == 0:
        out |= said(json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8")))
        out["own_error"] = follow(folder / "out" / "corrected.xml", case.rate, held)
    return out


def said(d: dict[str, Any]) -> Record:
    """What a diagnosis says; errors are held-out rms in the unit of what is compared."""
    physics = [f for f in d["findings"] if f["effect"] not in IDS]
    fit = d["fit"]
    return {
        "verdict": d["verdict"], "found": sorted(f["effect"] for f in physics), "places": [f["place"] for f in physics],
        "values": [{k: v["value"] for k, v in f["parameters"].items()} for f in physics],
        "numerics": [f["effect"] for f in d["findings"] if f["effect"] in IDS],
        "equivalents": sorted({e.split("@")[0] for f in physics for e in f["equivalents"]}),
        "reported": fit["corrected"]["held_out_rms"],
        "engine": fit.get("surrogate", {}).get("corrected", fit["corrected"])["held_out_rms"], "notes": d["notes"],
    }  # fmt: skip


@contextmanager
def measured(out: Record) -> Iterator[None]:
    """Add CPU seconds (of this process and its children) and wall seconds."""
    began, cpu = time.monotonic(), _cpu()
    yield
    out["seconds"], out["cpu_seconds"] = round(time.monotonic() - began, 2), round(_cpu() - cpu, 2)


def _cpu() -> float:
    return sum(u.ru_utime + u.ru_stime for u in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


def read(path: Path) -> dict[int, Record]:
    """Records by the number of their case; a line that was broken off is skipped."""
    out: dict[int, Record] = {}
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                record = json.loads(line)
            except json.JSONDecodeError:
                continue
            out[record["number"]] = record
    return out


def run_missing(
    cases: Sequence[C], path: Path, jobs: int, keep: Path | None, one: Callable[[C, Path, int], Record]
) -> Iterator[Record]:
    """Run the cases that a file of records lacks, in order, and append a line for each.

    ``keep``: folder of their files; ``one``: makes and diagnoses a case in a folder.
    """
    done = read(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    for case in cases:
        before = done.get(case.number)
        if before is not None and dataclasses.asdict(case).items() <= before.items():
            continue
        with TemporaryDirectory() as work:
            record = one(case, Path(work) if keep is None else keep / f"{case.number:03d}", jobs)
        with path.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(record) + "\n")
        yield record


def between_marks(page: Path, begin: str, end: str, text: str) -> int:
    """Put a text between two marks of a page; an exit code, 2 with a line on stderr where the page has no such marks."""
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        print(f"{page}: no markers {begin} and {end}", file=sys.stderr)
        return 2
    page.write_text(f"{before}{begin}\n\n{text}\n{end}{after}", encoding="utf-8")
    return 0
