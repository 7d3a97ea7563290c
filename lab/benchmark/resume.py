"""Results by case, computed side by side and kept as they come, so that a run that was broken off goes on where it stopped."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from ident.serial import write_atomic

__all__ = ["Job", "Shelf", "plain", "sealed_hashes"]


@dataclass(frozen=True)
class Job:
    """One result to compute: its name, and a call that a process of its own can make."""

    name: str
    work: Callable[..., dict[str, Any]]
    arguments: tuple[Any, ...]


@dataclass(frozen=True)
class Shelf:
    """A folder of results. A kept one counts while ``stamp`` (what it follows from besides the recordings) and the hashes of its
    recordings are the same; ``what`` and ``done`` say in words what is done to a case."""

    folder: Path
    stamp: str
    sealed: Mapping[str, Mapping[str, str]]
    what: str = "diagnosing"
    done: str = "diagnosed"

    def results(self, jobs: Sequence[Job], processes: int = 1) -> dict[str, dict[str, Any]]:
        """All results by name, in the order of the jobs; those that stand in the folder are not computed again."""
        kept, other = self._kept(jobs)
        if kept:
            click.echo(f"{len(kept)} of {len(jobs)} cases were {self.done} in an earlier run", err=True)
        if other:
            click.echo(f"{other} results of other code or another budget are computed again", err=True)
        left = [j for j in jobs if j.name not in kept]
        with _bar(self.what, len(jobs), len(kept)) as tick:
            for name, result in _each(left, processes):
                kept[name] = plain(result)
                said = {"case": name, "stamp": self.stamp, "sealed": self.sealed[name], "result": kept[name]}
                write_atomic(self.folder / f"{name}.json", json.dumps(said, indent=1) + "\n")
                tick(f"{self.what} {name}: {'error' if 'error' in result else result.get('verdict', 'done')}")
        return {j.name: kept[j.name] for j in jobs}

    def _kept(self, jobs: Sequence[Job]) -> tuple[dict[str, dict[str, Any]], int]:
        """What counts, and how many do not."""
        kept: dict[str, dict[str, Any]] = {}
        other = 0
        for job in jobs:
            try:
                said = json.loads((self.folder / f"{job.name}.json").read_text(encoding="utf-8"))
                if said["stamp"] == self.stamp and said["sealed"] == self.sealed[job.name]:
                    kept[job.name] = said["result"]
                else:
                    other += 1
            except (OSError, ValueError, KeyError, TypeError):
                continue
        return kept, other


def sealed_hashes(recordings: Path) -> dict[str, dict[str, str]]:
    """Hashes of the recordings of each case, as the manifest has them."""
    manifest = json.loads((recordings / "manifest.json").read_text(encoding="utf-8"))
    return {n: {k: v for k, v in manifest["recordings"].items() if k.startswith(f"{n}_")} for n in manifest["cases"]}


def plain(value: Any) -> Any:
    """JSON has no numpy numbers and no numbers that are not finite."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _each(jobs: Sequence[Job], processes: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Results as they come."""
    if processes <= 1 or len(jobs) < 2:
        for job in jobs:
            yield job.name, job.work(*job.arguments)
        return
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before the workers import numpy
        os.environ.setdefault(variable, "1")
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(j.work, *j.arguments): j.name for j in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def _bar(what: str, total: int, done: int) -> Iterator[Callable[[str], None]]:
    """Progress on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total, completed=done)
        yield lambda text: bar.update(task, description=text, advance=1)
