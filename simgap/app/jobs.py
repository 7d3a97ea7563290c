"""Commands in child processes: started, followed line by line, stopped.

A child runs ``python -P -m simgap``: -P keeps the run's folder off the module path, so that no uploaded file is imported.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from typing import IO

from mjsim.errors import InputError
from simgap.app import record
from simgap.app.runs import Run
from simgap.terminal import PROGRESS, one_line

__all__ = ["Job", "Jobs"]

MOST_JOBS = 2  # at a time: a diagnosis uses two threads
MOST_LINES = 5000  # that are kept of one command
PATIENCE = 5.0  # seconds after an interrupt before the child is killed; its fits are on disk by then
COLUMNS = "110"  # width of the tables that a command prints


@dataclass
class Job:
    """A command that runs or has run; `lines` grows, `code` is None while it runs."""

    command: str
    process: subprocess.Popen[str]
    lines: list[str] = field(default_factory=list)
    code: int | None = None
    stopped: bool = False


class Jobs:
    """The children of this server, one a run at most."""

    def __init__(self) -> None:
        self._jobs: dict[str, Job] = {}
        self._lock = threading.Lock()

    def of(self, run: Run) -> Job | None:
        """The last job of a run since the server started."""
        return self._jobs.get(run.id)

    def running(self, run: Run) -> bool:
        """Whether a command of the run works now."""
        job = self.of(run)
        return job is not None and job.code is None

    def start(self, run: Run, command: str) -> Job:
        """Start a command. Raises InputError where the run is not ready for it or too many run already."""
        words = run.words(command)
        with self._lock:
            if self.running(run):
                raise InputError(run.name, "a command of this run works already", "one at a time", "wait for it, or stop it")
            if sum(j.code is None for j in self._jobs.values()) >= MOST_JOBS:
                raise InputError(run.name, f"{MOST_JOBS} commands work already", "fewer", "wait for one, or stop one")
            with record.begin(run, command, words).open("wb") as printed:
                job = Job(command, subprocess.Popen(
                    [sys.executable, "-P", "-m", "simgap", *words], cwd=run.folder, text=True, encoding="utf-8", errors="replace",
                    stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.PIPE,
                    env=os.environ | {PROGRESS: "lines", "COLUMNS": COLUMNS, "NO_COLOR": "1", "PYTHONIOENCODING": "utf-8"},
                ))  # fmt: skip
            self._jobs[run.id] = job
        threading.Thread(target=self._follow, args=(run, job), daemon=True).start()
        return job

    def _follow(self, run: Run, job: Job) -> None:
        assert job.process.stderr is not None
        with job.process.stderr:
            _keep(job.process.stderr, job.lines)
        code = job.process.wait()
        with contextlib.suppress(OSError):  # the folder may be gone
            record.end(run, job.command, code, stopped=job.stopped, lines=job.lines)
        job.code = code

    def stop(self, run: Run) -> None:
        """Interrupt a running command, as Ctrl-C does; kill it where it does not end."""
        job = self.of(run)
        if job is None or job.code is not None:
            return
        job.stopped = True
        with contextlib.suppress(OSError):
            job.process.send_signal(signal.SIGINT)
        try:
            job.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            job.process.kill()
            job.process.wait()

    def close(self, runs: list[Run]) -> None:
        """Stop all, as the server ends."""
        for run in runs:
            self.stop(run)


def _keep(stream: IO[str], lines: list[str]) -> None:
    """Read a stream to its end; keep its first lines and always the last."""
    for raw in stream:
        line = one_line(raw)
        if line and len(lines) < MOST_LINES:
            lines.append(line)
        elif line:
            lines[-1] = line
