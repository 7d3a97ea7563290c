"""How a command of a run ended: its words, exit code, what it printed, and the files that it read.

JOBS/COMMAND.json   words, sizes and times of the files read, exit code, the line that it ended with
JOBS/COMMAND.txt    what it printed
JOBS/COMMAND.log    its progress
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from mjsim.errors import InputError
from mjsim.readers.source import files_of
from simgap.app.runs import Run, read_json, write_json

__all__ = ["Ending", "Record", "begin", "end", "record"]

MISSED = 1  # exit code: the command did its work, and what it checked is not as it should be
MOST_PRINTED = 200_000  # characters of what a command printed that a page shows
_CONTINUES = "{}; starting again continues where the command can"
_INPUTS = ("model/", "recordings/", "files/", "out/")


class Ending(Enum):
    """How a command ended."""

    DONE = "done"
    MISSED = "missed"
    REFUSED = "refused"
    STOPPED = "stopped"
    BROKEN_OFF = "broken off"


@dataclass(frozen=True)
class Record:
    """The last time that a command of a run was started.

    line: what it ended with on standard error; printed: its standard output; outdated: its inputs have changed since.
    """

    ending: Ending
    line: str
    printed: str
    outdated: bool


def begin(run: Run, command: str, words: Sequence[str]) -> Path:
    """Note that a command starts; where its standard output goes. Earlier results are removed unless they can be continued."""
    before = record(run, command)
    if before is not None and before.ending not in (Ending.STOPPED, Ending.BROKEN_OFF):
        shutil.rmtree(run.out(command), ignore_errors=True)
    run.out(command).mkdir(parents=True, exist_ok=True)
    folder = _folder(run)
    folder.mkdir(exist_ok=True)
    write_json(
        folder / f"{command}.json",
        {"words": list(words), "read": _read(run, words), "ending": Ending.BROKEN_OFF.value, "line": ""},
    )
    return folder / f"{command}.txt"


def end(run: Run, command: str, code: int, *, stopped: bool, lines: Sequence[str]) -> None:
    """Note how it ended, from its exit code and its lines on standard error."""
    last = lines[-1].removeprefix("simgap: ") if lines else ""
    ending = Ending.STOPPED if stopped else {0: Ending.DONE, MISSED: Ending.MISSED}.get(code, Ending.REFUSED)
    line = ""
    if ending is Ending.STOPPED:
        line = _CONTINUES.format("stopped")
    elif ending is Ending.MISSED:
        line = last
    elif ending is Ending.REFUSED:
        line = last if last and code > 0 else f"the process ended with code {code}"
    path = _folder(run) / f"{command}.json"
    write_json(path, {**read_json(path), "ending": ending.value, "line": line})
    (_folder(run) / f"{command}.log").write_text("".join(f"{text}\n" for text in lines), encoding="utf-8")


def record(run: Run, command: str) -> Record | None:
    """The record of a command; None where it was never started."""
    kept = read_json(_folder(run) / f"{command}.json")
    try:
        ending = Ending(kept["ending"])
    except (KeyError, ValueError):
        return None
    line = _CONTINUES.format("broken off with the server") if ending is Ending.BROKEN_OFF else str(kept["line"])
    return Record(ending, line, _printed(run, command), _outdated(run, command, kept))


def _folder(run: Run) -> Path:
    return run.folder / "jobs"


def _printed(run: Run, command: str) -> str:
    try:
        with (_folder(run) / f"{command}.txt").open(encoding="utf-8", errors="replace") as file:
            return file.read(MOST_PRINTED).rstrip()
    except OSError:
        return ""


def _read(run: Run, words: Sequence[str]) -> dict[str, Any]:
    """Size and time of each file of the run that the words name: recordings with their bindings, models with all files."""
    named = [word.partition("=")[2] if word.startswith("--") else word for word in words]
    paths: set[Path] = set()
    for name in (name for name in named if name.startswith(_INPUTS)):
        path = run.folder / name
        if name.startswith("model/"):
            paths |= {run.folder / "model" / file for file in run.files("model")}
        else:
            paths |= {file for file in files_of(path) if file.is_file()}
            paths |= {file for file in path.parent.glob("*.toml") if name.startswith("recordings/")}
    return {str(p.relative_to(run.folder)): [p.stat().st_size, p.stat().st_mtime_ns] for p in sorted(paths)}


def _outdated(run: Run, command: str, kept: dict[str, Any]) -> bool:
    try:
        words = run.words(command)
    except InputError:
        return True
    return words != kept.get("words") or _read(run, words) != kept.get("read")
