"""Work side by side on threads: simulations leave the interpreter's lock, so that threads share the cores and the arrays."""

from __future__ import annotations

import threading
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np

from mjsim.ode import count_work, work_done

__all__ = ["Counted", "SideBySide"]

T = TypeVar("T")


@dataclass(eq=False)
class _Offer(Generic[T]):
    """Tasks that one thread has asked for: those that nobody has taken, how many are not done, and what came of the others."""

    left: deque[tuple[int, Callable[[], T]]]
    undone: int
    answers: dict[int, T] = field(default_factory=dict)
    error: BaseException | None = None


class _Desk:
    """Where offers lie and threads that have nothing to do wait; it does not keep alive whom it serves."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.offers: list[_Offer[Any]] = []
        self.idle = 0
        self.closed = False

    def lay(self, offer: _Offer[Any]) -> None:
        """Offer tasks to whoever has nothing to do."""
        with self.changed:
            if self.closed:
                raise RuntimeError("no tasks are taken any more: the threads were closed")
            self.offers.append(offer)
            self.changed.notify_all()  # who waits for the end of another offer may not take this one

    def drop(self, offer: _Offer[Any]) -> bool:
        """Take back what is left of an offer; whether that was all of it."""
        with self.changed:
            untouched = not offer.answers and offer.error is None and len(offer.left) == offer.undone
            offer.undone -= len(offer.left)
            offer.left.clear()
            if offer in self.offers:
                self.offers.remove(offer)
            return untouched

    def take(self, offer: _Offer[Any]) -> bool:
        """Do one task of an offer; whether there was one."""
        try:
            i, task = offer.left.popleft()
        except IndexError:
            return False
        try:
            offer.answers[i] = task()
        except BaseException as error:  # an interrupt too is raised where the task was asked for
            with self.changed:
                offer.error = offer.error or error
            self.drop(offer)
        finally:
            with self.changed:
                offer.undone -= 1
                if offer.undone == 0:
                    self.changed.notify_all()
        return True

    def finish(self, offer: _Offer[Any]) -> None:
        """Wait for what others do of an offer, and do what they have offered since meanwhile: it is likely a part of that.

        Nothing that was offered earlier: that may be long, and what it asks for longer still.
        """
        while True:
            with self.changed:
                if offer.undone == 0:
                    break
                since = self.offers.index(offer) + 1 if offer in self.offers else len(self.offers)
                other = next((o for o in self.offers[since:] if o.left), None)
                if other is None:
                    self._rest()
                    continue
            self.take(other)
        if offer.error is not None:
            raise offer.error

    def serve(self) -> None:
        """Do what is offered, first what was offered first, until the desk closes."""
        while True:
            with self.changed:
                if self.closed:
                    return
                other = next((o for o in self.offers if o.left), None)
                if other is None:
                    self._rest()
                    continue
            self.take(other)
            other = None  # whose tasks hold arrays

    def _rest(self) -> None:
        """Wait for a change; the lock is held."""
        self.idle += 1
        try:
            self.changed.wait()
        finally:
            self.idle -= 1

    def close(self) -> None:
        """Take no more tasks, and let those go that wait for them."""
        with self.changed:
            self.closed = True
            self.changed.notify_all()


class SideBySide:
    """Threads that share out tasks, tasks of tasks among them.

    A thread that asks for tasks works on them itself, and the others help as they fall idle: first with what was asked for first.
    One that waits for its last task helps too, with what was asked for since. A fit that is left alone at the end of a race thus
    spreads its own simulations. Who calls from outside is one of the ``jobs``.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._desk = _Desk()
        self._threads = 0
        weakref.finalize(self, self._desk.close)

    def map(self, tasks: Sequence[Callable[[], T]], lengths: Sequence[float] | None = None) -> list[T]:
        """Answers in the order of the tasks, so that the number of threads changes nothing. The first error is raised.

        ``lengths``: how long each takes, in any unit. The longest is begun first: last, it would be at work alone in the end.
        """
        if self.jobs <= 1 or len(tasks) <= 1:
            return [task() for task in tasks]
        first = range(len(tasks)) if lengths is None else sorted(range(len(tasks)), key=lambda i: -lengths[i])
        offer = _Offer(deque((i, tasks[i]) for i in first), len(tasks))
        self._lay(offer)
        try:
            while self._desk.take(offer):
                pass
            self._desk.finish(offer)
        finally:
            self._desk.drop(offer)
        return [offer.answers[i] for i in range(len(tasks))]

    def beside(self, first: Callable[[], T], other: Callable[[], T]) -> tuple[T, Callable[[], T] | None]:
        """The answer of the first task, and how to ask for that of the other if a thread has nothing else to do at the moment."""
        if self.jobs <= 1 or (self._threads == self.jobs - 1 and not self._desk.idle):
            return first(), None
        offer = _Offer(deque([(0, other)]), 1)
        self._lay(offer)
        try:
            answer = first()
        except BaseException:
            self._desk.drop(offer)
            raise
        if self._desk.drop(offer):  # nobody came to it
            return answer, None

        def ask() -> T:
            self._desk.finish(offer)
            return offer.answers[0]

        return answer, ask

    def _lay(self, offer: _Offer[Any]) -> None:
        self._desk.lay(offer)
        while self._threads < self.jobs - 1:
            self._threads += 1
            threading.Thread(target=self._desk.serve, daemon=True).start()

    def close(self) -> None:
        """Stop: what the threads are at ends with an error as soon as it asks for more."""
        self._desk.close()


def _counting(task: Callable[[], T]) -> tuple[T, int]:
    """The answer of a task that simulates, and what that took."""
    before = work_done()
    answer = task()
    return answer, work_done() - before


Residual = np.ndarray | None


class Counted:
    """Runs residuals side by side and counts what they take: the same, whoever has run them."""

    def __init__(self, threads: SideBySide) -> None:
        self.work = 0
        self._threads = threads

    def run(self, tasks: Sequence[Callable[[], Residual]]) -> list[Residual]:
        """Answers in the order of the tasks."""
        told = self._threads.map([partial(_counting, task) for task in tasks])
        self.work += sum(work for _, work in told)
        return [answer for answer, _ in told]

    def beside(
        self, first: Callable[[], Residual], other: Callable[[], Residual]
    ) -> tuple[Residual, Callable[[], Residual] | None]:
        """`SideBySide.beside`; who asks for the other's answer is counted as if he had worked it out."""
        (answer, _), ask = self._threads.beside(lambda: (first(), 0), partial(_counting, other))

        def told() -> Residual:
            assert ask is not None
            value, work = ask()
            count_work(work)
            return value

        return answer, None if ask is None else told
