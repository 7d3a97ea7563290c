"""Work side by side on threads: simulations leave the interpreter's lock, so that threads share the cores and the arrays."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

__all__ = ["SideBySide"]

T = TypeVar("T")


class SideBySide:
    """Threads that share out tasks, tasks of tasks among them.

    A thread that asks for tasks works on them itself, and the others help as they fall idle: first with what was asked for first.
    A fit that is left alone at the end of a race thus spreads its own simulations, and no thread waits for one that has not
    begun. Who is none of the threads only waits, so that never more than ``jobs`` are at work.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._pool = ThreadPoolExecutor(max_workers=max(1, jobs))
        self._here = threading.local()
        self._counting = threading.Lock()
        self._at_work = 0

    def map(self, tasks: Sequence[Callable[[], T]], lengths: Sequence[float] | None = None) -> list[T]:
        """Answers in the order of the tasks, so that the number of threads changes nothing. The first error is raised.

        ``lengths``: how long each takes, in any unit. The longest is begun first: last, it would be at work alone in the end.
        """
        if self.jobs <= 1 or len(tasks) <= 1:
            return [task() for task in tasks]
        first = range(len(tasks)) if lengths is None else sorted(range(len(tasks)), key=lambda i: -lengths[i])
        left = deque((i, tasks[i]) for i in first)
        answers: dict[int, T] = {}

        def work() -> None:
            while left:
                try:
                    i, task = left.popleft()
                except IndexError:  # another thread was faster
                    return
                answers[i] = task()

        def help_out() -> None:
            self._here.working = True
            with self._counting:
                self._at_work += 1
            try:
                work()
            finally:
                with self._counting:
                    self._at_work -= 1

        inside = getattr(self._here, "working", False)
        helpers = [self._pool.submit(help_out) for _ in range(min(self.jobs, len(tasks)) - inside)]
        try:
            if inside:
                work()
            for helper in helpers:
                if not (inside and helper.cancel()):
                    helper.result()
        except BaseException:
            left.clear()
            for helper in helpers:
                helper.cancel()
            raise
        return [answers[i] for i in range(len(tasks))]

    def beside(self, tasks: Sequence[Callable[[], T]]) -> list[T]:
        """The answer of the first task, and those of the others if a thread has nothing else to do at the moment."""
        return self.map(tasks if 1 < self.jobs > self._at_work else tasks[:1])

    def close(self) -> None:
        """Stop: what the threads are at ends with an error as soon as it asks for more."""
        self._pool.shutdown(wait=False, cancel_futures=True)
