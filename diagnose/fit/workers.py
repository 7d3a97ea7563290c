"""A pool of threads for nested tasks. Simulations release the interpreter lock, so that threads share cores and arrays."""

from __future__ import annotations

import threading
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np

from mjsim.ode import work_done

__all__ = ["Counted", "WorkerPool"]

T = TypeVar("T")


@dataclass(eq=False)
class _Batch(Generic[T]):
    """Tasks of one call of `WorkerPool.map`: those not yet taken, how many are not done, answers by number, first error."""

    pending: deque[tuple[int, Callable[[], T]]]
    undone: int
    answers: dict[int, T] = field(default_factory=dict)
    error: BaseException | None = None


class _Queue:
    """Batches in the order of their calls, and the condition on which idle threads wait. It holds no reference to the pool."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.batches: list[_Batch[Any]] = []
        self.closed = False

    def add(self, batch: _Batch[Any]) -> None:
        """Offer a batch to idle threads. Raises RuntimeError once the queue is closed."""
        with self.changed:
            if self.closed:
                raise RuntimeError("the worker pool is closed and takes no more tasks")
            self.batches.append(batch)
            self.changed.notify_all()

    def cancel(self, batch: _Batch[Any]) -> None:
        """Drop the pending tasks of a batch."""
        with self.changed:
            batch.undone -= len(batch.pending)
            batch.pending.clear()
            if batch in self.batches:
                self.batches.remove(batch)

    def run_one(self, batch: _Batch[Any]) -> bool:
        """Run one pending task of a batch; False where there is none."""
        try:
            i, task = batch.pending.popleft()
        except IndexError:
            return False
        try:
            batch.answers[i] = task()
        except BaseException as error:  # an interrupt too is raised where the task was asked for
            with self.changed:
                batch.error = batch.error or error
            self.cancel(batch)
        finally:
            with self.changed:
                batch.undone -= 1
                if batch.undone == 0:
                    self.changed.notify_all()
        return True

    def join(self, batch: _Batch[Any]) -> None:
        """Wait until a batch is done, and run tasks of later batches meanwhile: they are likely parts of this one.

        Earlier batches are left alone: their tasks may be long.
        """
        while True:
            with self.changed:
                if batch.undone == 0:
                    break
                later = self.batches.index(batch) + 1 if batch in self.batches else len(self.batches)
                other = next((b for b in self.batches[later:] if b.pending), None)
                if other is None:
                    self.changed.wait()
                    continue
            self.run_one(other)
        if batch.error is not None:
            raise batch.error

    def serve(self) -> None:
        """Run pending tasks, those of the oldest batch first, until the queue is closed."""
        while True:
            with self.changed:
                if self.closed:
                    return
                other = next((b for b in self.batches if b.pending), None)
                if other is None:
                    self.changed.wait()
                    continue
            self.run_one(other)
            other = None  # its tasks hold arrays

    def close(self) -> None:
        """Take no more batches and end the threads."""
        with self.changed:
            self.closed = True
            self.changed.notify_all()


class WorkerPool:
    """Threads that share tasks, tasks of tasks among them; the calling thread is one of the ``jobs``.

    A thread that calls `map` works on its own tasks, idle threads help with the oldest call, and a thread that waits for the
    end of its call helps with later ones.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._queue = _Queue()
        self._threads = 0
        weakref.finalize(self, self._queue.close)

    def map(self, tasks: Sequence[Callable[[], T]], lengths: Sequence[float] | None = None) -> list[T]:
        """Answers in the order of the tasks, whatever the number of threads. The first error is raised.

        ``lengths``: how long each task takes, in any unit. The longest starts first.
        """
        if self.jobs <= 1 or len(tasks) <= 1:
            return [task() for task in tasks]
        order = range(len(tasks)) if lengths is None else sorted(range(len(tasks)), key=lambda i: -lengths[i])
        batch = _Batch(deque((i, tasks[i]) for i in order), len(tasks))
        self._queue.add(batch)
        while self._threads < self.jobs - 1:
            self._threads += 1
            threading.Thread(target=self._queue.serve, daemon=True).start()
        try:
            while self._queue.run_one(batch):
                pass
            self._queue.join(batch)
        finally:
            self._queue.cancel(batch)
        return [batch.answers[i] for i in range(len(tasks))]

    def close(self) -> None:
        """Stop: running tasks end with an error as soon as they ask for more."""
        self._queue.close()


def _counting(task: Callable[[], T]) -> tuple[T, int]:
    """The answer of a task that simulates, and its work."""
    before = work_done()
    answer = task()
    return answer, work_done() - before


class Counted:
    """Runs residuals on a pool and counts their work, which does not depend on the number of threads."""

    def __init__(self, threads: WorkerPool) -> None:
        self.work = 0
        self._threads = threads

    def run(self, tasks: Sequence[Callable[[], np.ndarray | None]]) -> list[np.ndarray | None]:
        """Answers in the order of the tasks."""
        answers = self._threads.map([partial(_counting, task) for task in tasks])
        self.work += sum(work for _, work in answers)
        return [answer for answer, _ in answers]
