"""A process that draws the pictures of a report: it loads what draws while the diagnosis runs, and draws at its end."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from multiprocessing import get_context
from typing import TypeAlias

__all__ = ["Draw", "Drawers", "Picture", "draw_here"]

Picture: TypeAlias = Callable[[], str | None]
Draw: TypeAlias = Callable[[Sequence[Picture]], list[str | None]]
Answer: TypeAlias = tuple[bool, str | None]  # whether it was drawn, and its text

MOST = 4  # pictures of a report are few
_SERVE = f"import sys; sys.path[:] = sys.argv[1:]; from {__name__} import serve; serve()"


def draw_here(pictures: Sequence[Picture]) -> list[str | None]:
    """Draw one picture after the other in this process."""
    return [picture() for picture in pictures]


class Drawers:
    """A process that loads beside the caller and, called, draws pictures, several at a time; none where ``jobs`` is one.

    Loading and drawing hold the interpreter's lock, which the fits need, so that no thread could do it beside them. The process
    runs this module alone: nothing is asked of the caller's ``__main__``. What it has not drawn, because it could not be
    started, has ended, cannot read what it was handed or has failed, is drawn here, where an error is raised.
    """

    def __init__(self, jobs: int) -> None:
        self._count = min(jobs, MOST)
        self._process: subprocess.Popen[bytes] | None = None
        if self._count > 1 and sys.executable and not getattr(sys, "frozen", False):  # else there is no interpreter to call
            call = [sys.executable, "-c", _SERVE, *sys.path]
            with contextlib.suppress(OSError):  # no process can be had
                self._process = subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)

    def __call__(self, pictures: Sequence[Picture]) -> list[str | None]:
        """The text of each picture."""
        answers: list[Answer] = []
        if self._process is not None:
            with contextlib.suppress(OSError, EOFError, pickle.UnpicklingError):  # it has ended
                answers = _asked(self._process, self._count, [_told(picture) for picture in pictures])
        answers = answers or [(False, None)] * len(pictures)
        return [text if done else picture() for (done, text), picture in zip(answers, pictures, strict=True)]

    def close(self) -> None:
        """End the process, and those it has begun."""
        if self._process is None:
            return
        with contextlib.suppress(ProcessLookupError):
            if sys.platform == "win32":
                self._process.kill()
            else:
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.communicate()
        self._process = None

    def __enter__(self) -> Drawers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _told(picture: Picture) -> bytes | None:
    """The picture as bytes, None where it holds what no other process can be told."""
    try:
        return pickle.dumps(picture)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None


def _asked(process: subprocess.Popen[bytes], count: int, told: list[bytes | None]) -> list[Answer]:
    assert process.stdin is not None
    assert process.stdout is not None
    pickle.dump((count, told), process.stdin)  # bytes in bytes: what cannot be read there does not put the pipe out of step
    process.stdin.flush()
    answers: list[Answer] = pickle.load(process.stdout)
    return answers


def _drawn(told: bytes | None) -> Answer:
    try:
        return (False, None) if told is None else (True, pickle.loads(told)())
    except Exception:  # raised again where the picture is drawn next
        return False, None


def _drawn_at_once(count: int, told: list[bytes | None]) -> list[Answer]:
    """Forks share what this process, which has one thread, has loaded."""
    if sys.platform != "linux":
        return [_drawn(each) for each in told]
    with ProcessPoolExecutor(count, mp_context=get_context("fork")) as forks:
        asked = [forks.submit(_drawn, each) for each in told]
        wait(asked)
        return [(False, None) if f.exception() else f.result() for f in asked]


def serve() -> None:
    """Draw what comes by standard input until it ends; standard output gets (whether it was drawn, text) of each picture."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asked is told, and ends this process
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    from diagnose.report import pictures

    pictures.load()
    while True:
        try:
            count, told = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        pickle.dump(_drawn_at_once(count, told), answers)
        answers.flush()
