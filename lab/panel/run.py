"""Run cases with the code of a checkout: on all cores, one JSON record a case, and on from where it was broken off."""

from __future__ import annotations

import json
import os
import queue
import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from ident.serial import write_atomic
from lab.panel.case import Case, Files, materialise
from lab.panel.record import Record, from_json, record_of, to_json
from lab.panel.tree import Tree
from lab.panel.worker import Worker
from mjsim.errors import InputError

__all__ = ["LIMIT", "Ran", "Setting", "run_cases"]

LIMIT = 1800.0  # [s] after which a case counts as an error; the search itself ends by its count of simulations, long before


@dataclass(frozen=True)
class Setting:
    """How cases are run.

    ``tree``: the code; ``cache``: folder of the files of cases; ``patches``, ``rule``: what is switched off, and its name;
    ``limit``: [s] until a case is an error; ``again``: errors of an earlier run are no answers; ``environment``: variables of the
    process that diagnoses; ``watched``: the patches of each rule whose acts are counted.
    """

    tree: Tree
    cache: Path
    patches: tuple[Mapping[str, Any], ...] = ()
    rule: str = ""
    limit: float = LIMIT
    again: bool = False
    environment: Mapping[str, str] = field(default_factory=dict)
    watched: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)

    @property
    def stamp(self) -> str:
        """What an answer follows from besides its case."""
        own = f" {json.dumps(dict(self.environment), sort_keys=True)}" if self.environment else ""
        seen = f" {json.dumps(dict(self.watched), sort_keys=True)}" if self.watched else ""
        return f"{self.tree.stamp} {json.dumps(list(self.patches), sort_keys=True)}{own}{seen}"


@dataclass(frozen=True)
class Ran:
    """Records by case; cases whose recordings are not on this machine, each with the reason; how many were there before."""

    records: Mapping[str, Record]
    absent: Mapping[str, str]
    kept: int


def _kept(path: Path, files: Files, setting: Setting) -> Record | None:
    """The record in a file, where it is of this case and code."""
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        if (said["stamp"], said["record"]["hash"]) == (setting.stamp, files.hash) and not (
            setting.again and said["record"]["error"]
        ):
            return from_json(said["record"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return None


class _Run:
    """The threads of a run share a queue of cases; each has a worker of its own."""

    def __init__(self, out: Path, setting: Setting, jobs: int, say: Callable[[str], None]) -> None:
        self.out, self.setting, self.jobs, self.say = out, setting, jobs, say
        self.records: dict[str, Record] = {}
        self.absent: dict[str, str] = {}
        self.kept = 0
        self._failed: list[BaseException] = []
        self._workers: list[Worker] = []
        self._stopped = False
        self._lock = threading.Lock()

    def all(self, cases: Sequence[Case]) -> None:
        todo: queue.SimpleQueue[Case] = queue.SimpleQueue()
        for case in cases:
            todo.put(case)
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before the processes that make recordings import numpy
            os.environ.setdefault(name, "1")
        with ProcessPoolExecutor(self.jobs, mp_context=get_context("spawn")) as makers:
            threads = [
                threading.Thread(target=self._serve, args=(k, todo, makers, len(cases)), daemon=True) for k in range(self.jobs)
            ]
            for thread in threads:
                thread.start()
            try:
                for thread in threads:
                    thread.join()
            except BaseException:  # broken off: what is half done leaves no record
                self._stopped = True
                for worker in self._workers:
                    worker.stop()
                raise
        if self._failed:
            raise self._failed[0]

    def _serve(self, number: int, todo: queue.SimpleQueue[Case], makers: ProcessPoolExecutor, total: int) -> None:
        worker = Worker(
            self.setting.tree, self.out / "log" / f"worker_{number}.txt", self.setting.patches, self.setting.environment,
            self.setting.watched,
        )  # fmt: skip
        self._workers.append(worker)
        try:
            while not (self._failed or self._stopped):
                case = todo.get_nowait()
                self._one(case, worker, number, makers, total)
        except queue.Empty:
            pass
        except BaseException as error:  # raised again where the run was begun
            self._failed.append(error)
        finally:
            worker.close()

    def _one(self, case: Case, worker: Worker, number: int, makers: ProcessPoolExecutor, total: int) -> None:
        made: Future[Files] = makers.submit(materialise, case, self.setting.cache)
        try:
            files = made.result()
        except InputError as error:
            with self._lock:
                self.absent[case.id] = str(error)
            return
        path = self.out / "records" / f"{case.id}.json"
        record = _kept(path, files, self.setting)
        before = record is not None
        if record is None:
            record = self._diagnosed(case, files, worker, number)
            if self._stopped:
                return
            said = {"stamp": self.setting.stamp, "rule": self.setting.rule, "record": json.loads(to_json(record))}
            write_atomic(path, json.dumps(said) + "\n")
        with self._lock:
            self.records[case.id] = record
            self.kept += before
            if not before:
                self.say(f"{len(self.records)}/{total} {_line(record)}")

    def _diagnosed(self, case: Case, files: Files, worker: Worker, number: int) -> Record:
        folder = self.out / "work" / str(number)
        shutil.rmtree(folder, ignore_errors=True)
        reply = worker.ask(files, folder.resolve(), self.setting.limit)
        result: dict[str, Any] = {}
        if "error" not in reply:
            result = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
            if result.get("simulations") is not None:  # of a commit that writes the number itself
                reply["simulations"] = result["simulations"]
        shutil.rmtree(folder, ignore_errors=True)
        return record_of(case.id, files.hash, self.setting.tree.commit, files.content, reply, result)


def _line(r: Record) -> str:
    """A record in one line of text."""
    named = " + ".join(r.named) or r.error[:100] or "-"
    taken = "" if r.simulations is None else f", {r.simulations} simulations"
    return f"{r.case}: {r.outcome or 'no truth'}, {r.verdict}, {named} ({r.seconds:.1f} s, {r.cpu_seconds:.1f} s CPU{taken})"


def run_cases(cases: Sequence[Case], out: Path, setting: Setting, jobs: int, say: Callable[[str], None] = lambda _: None) -> Ran:
    """Diagnose cases and keep each record in ``out/records``; those that stand there by the same code are not computed again.

    A case that fails is a record with ``error``. Raises InputError where the checkout cannot be run.
    """
    run = _Run(out, setting, max(1, min(jobs, len(cases))), say)
    run.all(cases)
    return Ran(run.records, run.absent, run.kept)
