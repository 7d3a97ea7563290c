"""Processes that draw the pictures of a report: they load what draws while the diagnosis runs, and draw at its end."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock, Thread
from typing import TypeAlias

__all__ = ["Draw", "Drawers", "Picture", "draw_here"]

Picture: TypeAlias = Callable[[], str | None]
Draw: TypeAlias = Callable[[Sequence[Picture]], list[str | None]]

MOST = 4  # pictures of a report are few, and each process holds memory
_SERVE = "import sys; sys.path[:] = sys.argv[1:]; from diagnose.drawers import serve; serve()"


def draw_here(pictures: Sequence[Picture]) -> list[str | None]:
    """Draw one picture after the other in this process."""
    return [picture() for picture in pictures]


class Drawers:
    """As many processes as there are ``jobs``, none where it is one; called, they draw pictures in their order.

    Loading and drawing hold the interpreter's lock, which the fits need, so that no thread could do it beside them. A process
    runs this module alone: nothing is asked of the caller's ``__main__``. What no process has drawn, because it could not be
    started, has ended, cannot read what it was handed or has failed, is drawn here, where an error is raised.
    """

    def __init__(self, jobs: int) -> None:
        python = sys.executable and not getattr(sys, "frozen", False)  # else there is no interpreter to call
        count = min(jobs, MOST) if jobs > 1 and python else 0
        self._processes: list[subprocess.Popen[bytes]] = []
        self._closing, self._closed = Lock(), False
        self._starting = Thread(target=self._start, args=(count,), daemon=True)
        self._starting.start()

    def _start(self, count: int) -> None:
        """One process after the other, each when the one before it has loaded: the diagnosis keeps a core for itself."""
        for _ in range(count):
            with self._closing:
                if self._closed:
                    return
                call = [sys.executable, "-c", _SERVE, *sys.path]
                try:
                    process = subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
                except OSError:  # no process can be had: the others, or this one, draw
                    return
                self._processes.append(process)
            assert process.stdout is not None
            with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):  # it has ended: whoever hands it a picture sees
                pickle.load(process.stdout)

    def __call__(self, pictures: Sequence[Picture]) -> list[str | None]:
        """The text of each picture."""
        left = deque(range(len(pictures)))
        drawn: dict[int, str | None] = {}

        def hand_out(process: subprocess.Popen[bytes]) -> None:
            while left:
                try:
                    i = left.popleft()
                except IndexError:  # another process was faster
                    return
                try:
                    done, text = _asked(process, pictures[i])
                except (OSError, EOFError, pickle.UnpicklingError):  # the process has ended
                    return
                if done:
                    drawn[i] = text

        self._starting.join()
        if self._processes:
            with ThreadPoolExecutor(len(self._processes)) as threads:
                list(threads.map(hand_out, self._processes))
        return [drawn[i] if i in drawn else picture() for i, picture in enumerate(pictures)]

    def close(self) -> None:
        """End the processes."""
        with self._closing:
            self._closed = True
            for process in self._processes:
                process.kill()
        self._starting.join()
        for process in self._processes:
            process.communicate()
        self._processes.clear()

    def __enter__(self) -> Drawers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _asked(process: subprocess.Popen[bytes], picture: Picture) -> tuple[bool, str | None]:
    """Whether the process has drawn the picture, and its text."""
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        handed = pickle.dumps(picture)
    except (pickle.PicklingError, AttributeError, TypeError):  # it holds what no other process can be told
        return False, None
    pickle.dump(handed, process.stdin)  # bytes in bytes: what cannot be read there does not put the pipe out of step
    process.stdin.flush()
    answer: tuple[bool, str | None] = pickle.load(process.stdout)
    return answer


def serve() -> None:
    """Draw what comes by standard input until it ends.

    Standard output gets a word once all is loaded, then (whether it was drawn, text) for each picture.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asked is told, and ends this process
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401

    import diagnose.report.pictures  # noqa: F401

    pickle.dump("loaded", answers)
    answers.flush()
    while True:
        try:
            handed = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        answer: tuple[bool, str | None]
        try:
            answer = True, pickle.loads(handed)()
        except Exception:
            answer = False, None
        pickle.dump(answer, answers)
        answers.flush()
