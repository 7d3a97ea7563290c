"""The process that fuzzes: ``python -m lab.fuzz.worker READER TOLD KEEP [libFuzzer options]``."""

from __future__ import annotations

import atexit
import hashlib
import importlib
import json
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from lab.fuzz.targets import TARGETS, Target

__all__ = ["main"]

TOLD = 0.2
"""Seconds between two reports of the counts; those since the last one are lost where the process is ended."""


class Counter:
    """Reads what the fuzzer makes, and counts what comes of it."""

    def __init__(self, reader: str, target: Target, told: Path, keep: Path, work: Path) -> None:
        self._target, self._told, self._keep = target, told, keep
        self._reader = reader
        self._path = work / f"log{target.suffix}"
        self._said: dict[str, Any] = {"valid": 0, "refused": 0, "slowest_s": 0.0, "finds": {}}
        self._wrote = 0.0

    def __call__(self, data: bytes) -> None:
        """One execution."""
        from mjsim.errors import InputError

        self._path.write_bytes(data)
        began = time.perf_counter()
        try:
            self._target.read(self._path)
            self._said["valid"] += 1
        except InputError:
            self._said["refused"] += 1
        except BaseException as error:
            self._find(data, error)
        now = time.perf_counter()
        self._said["slowest_s"] = max(self._said["slowest_s"], now - began)
        if now - self._wrote > TOLD:
            self.write()

    def _find(self, data: bytes, error: BaseException) -> None:
        at = traceback.extract_tb(error.__traceback__)[-1]
        name = f"{type(error).__name__} at {Path(at.filename).name}:{at.lineno}"
        if name not in self._said["finds"]:
            path = self._keep / f"{self._reader}-{hashlib.sha256(data).hexdigest()[:12]}{self._target.suffix}"
            path.write_bytes(data)
            self._said["finds"][name] = f"{path.name}: {error}"[:300]
            self.write()

    def write(self) -> None:
        """Write the counts down, since the fuzzer ends the process."""
        self._told.write_text(json.dumps(self._said))
        self._wrote = time.perf_counter()


def main() -> None:
    """Fuzz until libFuzzer's options end it."""
    import atheris

    reader, told, keep, *options = sys.argv[1:]
    target = TARGETS[reader]
    with atheris.instrument_imports(include=list(target.instrument)):
        for name in target.instrument:
            importlib.import_module(name)
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as work:
        counter = Counter(reader, target, Path(told), Path(keep), Path(work))
        atheris.Setup([sys.argv[0], *options], counter)
        atexit.register(counter.write)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
