"""A case of the panel: files that the command line of any commit reads, and what is known of the machine behind them."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ident.serial import write_atomic

__all__ = ["Case", "Content", "Files", "case_hash", "materialise"]


@dataclass(frozen=True)
class Content:
    """What a maker wrote into a folder.

    ``estimation``, ``held_out``: names of recordings; ``model``: name of the MJCF, whose binding stands beside it; ``options``:
    of the diagnosis. ``truth``: as the benchmark's envelope has it; ``expected``: for a machine whose truth is published and not
    sealed: ``verdicts`` and ``effects``, a list of the sets of names that count as right. Neither: answers are compared, and
    are neither right nor wrong.
    """

    estimation: tuple[str, ...]
    held_out: tuple[str, ...]
    model: str
    truth: Mapping[str, Any] | None = None
    expected: Mapping[str, Any] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """One case.

    ``id``: its name, and that of its folder. ``origin``: the set it belongs to (sealed, cited, practice, real, example, wish);
    ``level``: the benchmark's level, or the kind of machine. ``make`` writes the files of the case into an empty folder; it
    gives the same bytes each time, and raises InputError where a recording is not on this machine.
    """

    id: str
    origin: str
    level: str
    make: Callable[[Path], Content]

    @property
    def stratum(self) -> str:
        """Origin and level."""
        return f"{self.origin}/{self.level}"


@dataclass(frozen=True)
class Files:
    """A case on disk: its folder, its content and the SHA-256 of what a diagnosis of it follows from."""

    folder: Path
    content: Content
    hash: str


def case_hash(folder: Path, content: Content) -> str:
    """SHA-256 over names, bytes and parts of all files but ``case.json``, and over the options; not over the truth."""
    asked = [list(content.estimation), list(content.held_out), content.model, dict(content.options)]
    digest = hashlib.sha256(json.dumps(asked, sort_keys=True).encode())
    for path in sorted(p for p in folder.iterdir() if p.name != "case.json"):
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def materialise(case: Case, cache: Path) -> Files:
    """Write the files of a case to ``cache/ID``, or read what stands there already.

    The folder gets its name when it is whole. Raises InputError where a recording of the case is not on this machine.
    """
    folder = cache / case.id
    if not (folder / "case.json").is_file():
        cache.mkdir(parents=True, exist_ok=True)
        scratch = cache / f".{case.id}.{os.getpid()}"
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        try:
            content = case.make(scratch)
            said = {
                "id": case.id, "origin": case.origin, "level": case.level, "hash": case_hash(scratch, content),
                "estimation": list(content.estimation), "held_out": list(content.held_out), "model": content.model,
                "options": dict(content.options), "truth": content.truth, "expected": content.expected,
            }  # fmt: skip
            write_atomic(scratch / "case.json", json.dumps(said, indent=1) + "\n")
            try:
                scratch.rename(folder)
            except OSError:
                if not (folder / "case.json").is_file():  # else another process has written the same meanwhile
                    raise
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    said = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    content = Content(
        tuple(said["estimation"]), tuple(said["held_out"]), said["model"], said["truth"], said["expected"], said["options"]
    )
    return Files(folder, content, said["hash"])
