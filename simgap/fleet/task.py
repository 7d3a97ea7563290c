"""One diagnosis of a fleet, in a worker: a record on disk, whole or not at all."""

from __future__ import annotations

import errno
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

UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""Error numbers of a full disk, a quota, a limit on the size of a file and a read-only file system."""


def place(out: Path, key: str) -> Path:
    """Where the record of a key stands: in one of 256 folders, so that none holds more than a few thousand of a million."""
    return out / "records" / key[:2] / f"{key}.json"


def diagnose_one(job: Job, out: str) -> str:
    """Diagnose one recording and write its record; returns the key.

    A recording that cannot be used, and a fault, are records as well: the fleet goes on. A record that is there is kept. Raises
    OSError where another file than the recording cannot be read or written, as on a full disk: that is no record.
    """
    target = place(Path(out), job.key)
    if not target.exists():
        write_record(target, record_of(job, Path(out)))
    return job.key


def record_of(job: Job, out: Path) -> dict[str, Any]:
    """The record of one job: what it is, how long it took, and the diagnosis or why there is none.

    Raises OSError that is not of the recording.
    """
    began = time.perf_counter()
    record: dict[str, Any] = {"job": job.as_dict()}
    try:
        record["diagnosis"] = _diagnosis(job, out / "logs" / job.key if job.settings.reports else None)
    except InputError as error:
        record["refused"] = str(error)
    except OSError as error:
        if not _of_recording(error, job):
            raise
        said = error.strerror or str(error)
        record["refused"] = str(InputError(job.log, said, "a file that can be read", "check the path and its permissions"))
    except Exception as error:  # of one recording; the others are diagnosed all the same
        record["fault"] = f"{type(error).__name__}: {error}"
        record["where"] = traceback.format_exc(limit=-3)
    record["seconds"] = time.perf_counter() - began
    return record


def _of_recording(error: OSError, job: Job) -> bool:
    """Whether what the system refused is to read the recording or its binding."""
    if error.filename is None:
        return error.errno not in UNWRITABLE
    log = Path(job.log)
    return Path(str(error.filename)) in (log, log.with_suffix(".toml"))


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
