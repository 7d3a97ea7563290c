"""The diagnoses of a fleet on a Dask cluster: bounded in flight, resumed, done again where a worker is lost."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from mjsim.errors import InputError
from simgap.fleet.plan import Job, select
from simgap.fleet.table import read_records
from simgap.fleet.task import diagnose_one, place, write_record

__all__ = ["done", "forget_failed", "run"]

AHEAD = 3  # jobs in flight for each thread of a worker: none waits for the client, and a million jobs need no memory
LOSSES = 3  # workers that one job may lose before it is given up: a recording that needs more memory than there is


def done(out: Path) -> set[str]:
    """Keys of the jobs that have a record."""
    return {p.stem for p in (out / "records").glob("*/*.json")}


def forget_failed(all_jobs: Sequence[Job], out: Path) -> int:
    """Remove the records of jobs that failed by a fault or a lost worker, so that they run again; returns how many."""
    failed = [record["job"]["key"] for record in read_records(out, (j.key for j in all_jobs)) if "fault" in record]
    for key in failed:
        place(out, key).unlink(missing_ok=True)
    return len(failed)


def run(
    all_jobs: Sequence[Job], out: Path, *, scheduler: str = "", workers: int = 2, memory: str = "auto",
    progress: Callable[[int, int], None] = lambda finished, total: None,
) -> int:  # fmt: skip
    """Run what has no record yet; returns how many jobs ran. ``scheduler``: the address of a Dask scheduler, else a local
    cluster.

    Workers of a cluster need the recordings, the model and ``out`` under the same paths. Raises InputError where the scheduler
    does not answer, and where a worker cannot write its files or read the model: afterwards the same call continues.
    """
    with contextlib.suppress(OSError):
        for part in (out / "records").glob("*/*.part"):
            part.unlink()
    todo = select(all_jobs, done(out))
    total, finished = len(all_jobs), len(all_jobs) - len(todo)
    progress(finished, total)
    if not todo:
        return 0
    (out / "records").mkdir(parents=True, exist_ok=True)
    with _client(scheduler, workers, memory) as client:
        for key, error in _results(client, todo, str(out)):
            if error is not None:
                job = next(j for j in todo if j.key == key)
                write_record(place(out, key), {"job": job.as_dict(), "fault": error, "seconds": None})
            finished += 1
            progress(finished, total)
    return len(todo)


def _attempt(job: Job, out: str) -> str:
    """Diagnose one recording in a worker; returns which file cannot be written or read ("": none), since Dask repeats a task
    that raises."""
    try:
        diagnose_one(job, out)
    except OSError as error:
        return f"{error.filename or 'a file'}: {error.strerror or error}"
    return ""


def _results(client: Any, todo: Sequence[Job], out: str) -> Iterator[tuple[str, str | None]]:
    """(key, error or None) of each job as it ends, with no more than `AHEAD` of them in flight for each thread.

    Raises InputError where a worker cannot use a file that is not the recording.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    threads = max(1, sum(client.nthreads().values()))
    waiting = iter(todo)

    def submit(job: Job) -> Any:
        return client.submit(_attempt, job, out, key=f"simgap-{job.key}", pure=False, retries=1)

    running = as_completed([submit(j) for _, j in zip(range(AHEAD * threads), waiting, strict=False)])
    for future in running:
        key, unusable = str(future.key).removeprefix("simgap-"), ""
        try:
            unusable, error = future.result(), None
        except KilledWorker:
            error = f"{LOSSES} workers were lost while they diagnosed it, for want of memory or by a fault"
        except Exception as problem:
            error = f"{type(problem).__name__}: {problem}"
        future.release()
        if unusable:
            raise InputError(out, f"the fleet is not finished: {unusable}", todo="then the same command continues")
        job = next(waiting, None)
        if job is not None:
            running.add(submit(job))
        yield key, error


def _need_memory(memory: str) -> None:
    """Check a memory limit of workers: ``auto``, or what Dask reads as bytes. Raises InputError."""
    from dask.utils import parse_bytes

    if memory != "auto":
        with contextlib.suppress(ValueError, OverflowError):
            if parse_bytes(memory) >= 0:
                return
        raise InputError("--memory", f"{memory!r}", "auto, or a size such as 2GB or 500MB", "correct it")


@contextlib.contextmanager
def _client(scheduler: str, workers: int, memory: str) -> Iterator[Any]:
    """A Dask client of a running scheduler or of a local cluster: processes of one thread each."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError(
            "simgap fleet", "the package 'distributed' is not installed", "it", "pip install 'simgap[fleet]'"
        ) from None
    _need_memory(memory)
    options = {
        "distributed.scheduler.allowed-failures": LOSSES, "distributed.logging.distributed": "error",
        "distributed.worker.daemon": False, "distributed.comm.timeouts.connect": "10s",
        # log entries that a cluster keeps of its own activity: they grow with each task, the monitor with time
        "distributed.admin.system-monitor.log-length": 60, "distributed.admin.log-length": 100,
        "distributed.admin.low-level-log-length": 100,
        "distributed.worker.profile.enabled": False,
    }  # fmt: skip
    single = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    with dask.config.set(options), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Port .* is already in use")  # of the page of another cluster on this machine
        if scheduler:
            try:
                with Client(scheduler) as client:
                    yield client
            except (OSError, TimeoutError) as error:
                raise InputError(
                    "--scheduler", f"{scheduler} does not answer ({error})", "a Dask scheduler", "check the address"
                ) from None
            return
        with (
            LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, memory_limit=memory, env=os.environ | single,
                dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False}, silence_logs=50,
            ) as cluster,
            Client(cluster) as client,
        ):  # fmt: skip
            yield client
