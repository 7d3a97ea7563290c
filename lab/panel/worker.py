"""A process that diagnoses case after case with the code of a checkout."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from lab.panel import driver
from lab.panel.case import Files
from lab.panel.tree import Tree
from mjsim.errors import InputError

__all__ = ["Worker", "WorkerError"]

READY = 600.0  # [s] until a checkout whose simulation has to be compiled is ready


class WorkerError(RuntimeError):
    """The process has ended, or does not answer in time: one line that says which."""


class Worker:
    """`driver.py` in a process of its own: one thread for the linear algebra, one job a diagnosis.

    ``log``: file that what the process prints is appended to; ``patches``: what is switched off in it; ``environment``: its
    further variables; ``watched``: the patches of each rule whose acts are counted.
    """

    def __init__(
        self, tree: Tree, log: Path, patches: Sequence[Mapping[str, Any]] = (), environment: Mapping[str, str] | None = None,
        watched: Mapping[str, Sequence[Mapping[str, Any]]] | None = None,
    ) -> None:  # fmt: skip
        self._watched = dict(watched or {})
        self._tree, self._log, self._patches, self._environment = tree, log, list(patches), dict(environment or {})
        self._process: subprocess.Popen[bytes] | None = None
        self._stderr: IO[bytes] | None = None
        self._rest = b""

    def ask(self, files: Files, out: Path, limit: float) -> dict[str, Any]:
        """What the driver says of a case, whose folder ``out`` it fills.

        That the process has ended, or has taken over ``limit`` [s], is an answer with ``error``.
        Raises InputError where the checkout cannot be imported or a patch no longer fits it.
        """
        try:
            if self._process is None:
                self._start()
            content = files.content
            self._send({
                "folder": str(files.folder), "estimation": content.estimation, "held_out": content.held_out,
                "model": content.model, "options": dict(content.options), "out": str(out),
            })  # fmt: skip
            return self._answer(limit)
        except WorkerError as error:
            self.close()
            return {"error": str(error)}

    def stop(self) -> None:
        """End the process while another thread may wait for its answer, which is then an error."""
        if self._process is not None:
            self._process.kill()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout, self._stderr):
                assert stream is not None
                stream.close()
        self._process, self._stderr, self._rest = None, None, b""

    def _start(self) -> None:
        self._log.parent.mkdir(parents=True, exist_ok=True)
        self._stderr = self._log.open("ab")
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        asked = json.dumps({"tree": str(self._tree.folder), "patches": self._patches, "watched": self._watched})
        self._process = subprocess.Popen(
            [sys.executable, "-P", driver.__file__, asked], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._stderr,
            cwd=self._tree.folder, start_new_session=True,
            env={**os.environ, **single, **self._environment, "PYTHONPATH": str(self._tree.folder)},
        )  # fmt: skip
        said = self._answer(READY)
        if not said["ready"]:
            self.close()
            raise InputError(
                self._tree.folder, said["error"], "a checkout that the panel can run", "retarget the rule or correct --tree"
            )

    def _send(self, asked: Mapping[str, Any]) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(asked).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            raise WorkerError(self._ended()) from None

    def _answer(self, limit: float) -> dict[str, Any]:
        """The next line."""
        assert self._process is not None
        assert self._process.stdout is not None
        handle, until = self._process.stdout.fileno(), time.monotonic() + limit
        while b"\n" not in self._rest:
            ready, _, _ = select.select([handle], [], [], max(0.0, until - time.monotonic()))
            if not ready:
                raise WorkerError(f"no answer within {limit:.0f} s")
            part = os.read(handle, 65536)
            if not part:
                raise WorkerError(self._ended())
            self._rest += part
        line, _, self._rest = self._rest.partition(b"\n")
        said: dict[str, Any] = json.loads(line)
        return said

    def _ended(self) -> str:
        """That the process has ended, and its last words."""
        assert self._process is not None
        try:
            code = self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        lines = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["nothing was printed"]
        return f"the process ended with {code}: {lines[-1][:200]}"
