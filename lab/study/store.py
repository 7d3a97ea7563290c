"""Cells kept on disk under the hash of their inputs, and computed side by side."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from lab.study.cell import Cell, Result, run_cell
from mjsim.errors import InputError

__all__ = ["Store", "compute", "stamp"]


@cache
def stamp() -> str:
    """Hash of what a cell follows from besides its inputs: the model's file, the code that computes it, the libraries."""
    import mujoco
    import numba
    import numpy
    import scipy

    import ident
    import mjsim
    from mjsim.models import shipped_model

    digest = hashlib.sha256()
    digest.update(shipped_model("robot_axis1").read_bytes())
    for package in (mjsim, ident):
        root = Path(str(package.__file__)).parent
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    here = Path(__file__).parent
    for name in ("cell.py", "pipeline.py", "plants.py"):
        digest.update((here / name).read_bytes())
    for version in (platform.python_version(), numpy.__version__, scipy.__version__, numba.__version__, mujoco.__version__):
        digest.update(version.encode())
    return digest.hexdigest()


@dataclass(frozen=True)
class Store:
    """A folder of results, one file per cell; what is there is not computed again."""

    folder: Path
    stamp: str

    def open(self) -> None:
        """Make the folder; InputError when it cannot be written."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            where = self.folder.parent
            raise InputError(where, f"cannot be written ({error.strerror})", "a writable folder") from None

    def path(self, inputs: Any) -> Path:
        """Where the result of these inputs is kept."""
        text = json.dumps(inputs, sort_keys=True) + self.stamp
        return self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.json"

    def get(self, cell: Cell) -> Result | None:
        """The kept result, or None; a file that cannot be read counts as not there."""
        try:
            return Result.from_dict(json.loads(self.path(cell.inputs()).read_text(encoding="utf-8"))["result"])
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def put(self, cell: Cell, result: Result) -> None:
        """Keep a result; a broken run leaves nothing under its name."""
        from ident.serial import write_atomic

        write_atomic(
            self.path(cell.inputs()), json.dumps({"inputs": cell.inputs(), "result": result.to_dict()}, separators=(",", ":"))
        )

    def remember(self, inputs: Any, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The kept plain values of these inputs, or those that ``work`` gives, which are then kept."""
        from ident.serial import write_atomic

        path = self.path(inputs)
        try:
            return dict(json.loads(path.read_text(encoding="utf-8"))["result"])
        except (OSError, ValueError, KeyError, TypeError):
            result = work()
            write_atomic(path, json.dumps({"inputs": inputs, "result": result}, separators=(",", ":")))
            return result


WATCH_SECONDS = 1.0
"""How often a worker looks whether its run is still there."""


def _end_with(parent: int) -> None:
    """In a worker: end when the process that started it has gone, killed for instance, instead of waiting for ever."""
    import threading
    import time

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def compute(
    cells: Iterable[Cell], store: Store, jobs: int = 1, tick: Callable[[int], None] = lambda done: None
) -> dict[Cell, Result]:
    """Results of all cells, from the store or new, ``jobs`` side by side. Safe to break off.

    ``tick``: called with the number of cells there are, first with those that were kept, then after each new one.
    """
    wanted = list(dict.fromkeys(cells))
    store.open()
    out: dict[Cell, Result] = {}
    for cell in wanted:
        kept = store.get(cell)
        if kept is not None:
            out[cell] = kept
    tick(len(out))
    left = [c for c in wanted if c not in out]

    def keep(cell: Cell, result: Result) -> None:
        store.put(cell, result)
        out[cell] = result
        tick(len(out))

    if jobs <= 1 or len(left) < 2 * jobs:
        for cell in left:
            keep(cell, run_cell(cell))
        return out
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    # the small matrices here gain nothing from BLAS threads; set before the workers import numpy
    before = {k: os.environ.get(k) for k in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    os.environ.update(dict.fromkeys(before, "1"))
    try:
        with ProcessPoolExecutor(jobs, get_context("spawn"), _end_with, (os.getpid(),)) as pool:
            futures = {pool.submit(run_cell, c): c for c in left}
            try:
                for future in as_completed(futures):
                    keep(futures[future], future.result())
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value
    return out
