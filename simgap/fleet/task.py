"""One diagnosis of a fleet, in a worker: a record on disk, whole or not at all."""

from __future__ import annotations

import json
import os
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjsim.errors import InputError, writing
from simgap.fleet.plan import Job

__all__ = ["diagnose_one", "place", "record_of", "write_record"]


KEPT = ("verdict", "summary", "findings", "fit", "linear_parameters", "joints", "next_experiment", "noise_floor", "stretches")
"""Keys of ``diagnosis.json`` that a record keeps."""


def place(out: Path, key: str) -> Path:
    """Where the record of a key stands: in one of 256 folders, so that none holds more than a few thousand of a million."""
    return out / "records" / key[:2] / f"{key}.json"


def diagnose_one(job: Job, out: str) -> str:
    """Diagnose one recording and write its record; returns the key.

    A recording that cannot be used, and a fault, are records as well: the fleet goes on. A record that is there is kept.
    """
    target = place(Path(out), job.key)
    if not target.exists():
        write_record(target, record_of(job, Path(out)))
    return job.key


def record_of(job: Job, out: Path) -> dict[str, Any]:
    """The record of one job: what it is, how long it took, and the diagnosis or why there is none."""
    began = time.perf_counter()
    record: dict[str, Any] = {"job": job.as_dict()}
    try:
        record["diagnosis"] = _diagnosis(job, out / "logs" / job.key if job.settings.reports else None)
    except (InputError, OSError) as error:
        record["refused"] = str(error)
    except Exception as error:  # of one recording; the others are diagnosed all the same
        record["fault"] = f"{type(error).__name__}: {error}"
        record["where"] = traceback.format_exc(limit=-3)
    record["seconds"] = time.perf_counter() - began
    return record


def _diagnosis(job: Job, folder: Path | None) -> dict[str, Any]:
    import simgap

    s = job.settings
    found = simgap.diagnose(
        job.log, job.model, out=folder, effects=s.effects, joints=s.joints, seed=s.seed, effort=s.effort, accept_log=s.accept_log
    )
    told: Mapping[str, Any] = found.as_dict()
    return {k: told[k] for k in KEPT if k in told}


def write_record(target: Path, record: Mapping[str, Any]) -> None:
    """Write a record beside its final name, then move it there: a process that is killed leaves none or a whole one."""
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_suffix(f".{os.getpid()}.part")
    try:
        with writing(target):
            part.write_text(json.dumps(record, sort_keys=True), encoding="utf-8")
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
