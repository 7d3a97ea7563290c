"""Threads that share out tasks: order, errors, help for a task of tasks, and no more at work than were asked for."""

from __future__ import annotations

import threading
import time
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diagnose.fit.workers import Counted, WorkerPool
from mjsim.ode import count_work


@given(st.integers(1, 4), st.lists(st.integers(0, 6), max_size=6))
@settings(max_examples=60, deadline=None)
def test_answers_stand_in_the_order_of_the_tasks(jobs, sizes):
    threads = WorkerPool(jobs)

    def inner(i: int, k: int) -> tuple[int, int]:
        return i, k

    def outer(i: int, n: int) -> list[tuple[int, int]]:
        return threads.map([partial(inner, i, k) for k in range(n)])

    try:
        assert threads.map([partial(outer, i, n) for i, n in enumerate(sizes)]) == [
            [(i, k) for k in range(n)] for i, n in enumerate(sizes)
        ]
    finally:
        threads.close()


def test_an_idle_thread_helps_with_the_tasks_of_a_task():
    threads = WorkerPool(2)
    together = threading.Barrier(2)

    def lone() -> list[int]:
        return threads.map([lambda: together.wait(20), lambda: together.wait(20)])

    try:  # both wait for each other: on one thread neither would come through
        assert sorted(threads.map([lone, lambda: -1])[0]) == [0, 1]
    finally:
        threads.close()


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_no_more_are_at_work_than_were_asked_for(jobs):
    threads = WorkerPool(jobs)
    lock = threading.Lock()
    at_work, most = 0, 0

    def leaf() -> None:
        nonlocal at_work, most
        with lock:
            at_work += 1
            most = max(most, at_work)
        threading.Event().wait(0.002)
        with lock:
            at_work -= 1

    try:
        threads.map([lambda: threads.map([leaf] * 5)] * 6)
    finally:
        threads.close()
    assert 1 <= most <= jobs


def test_one_that_waits_for_its_last_task_helps_with_what_that_asks_for():
    threads = WorkerPool(2)
    taken, together = threading.Event(), threading.Barrier(2)

    def first() -> None:
        taken.wait(20)

    def last() -> list[int]:
        taken.set()  # the other thread is here, and the one that asked has nothing left but to wait for it
        return threads.map([lambda: together.wait(20), lambda: together.wait(20)])

    try:
        assert sorted(threads.map([lambda: threads.map([first, last])[1]])[0]) == [0, 1]
    finally:
        threads.close()


def test_threads_that_nobody_uses_any_more_end():
    before = threading.active_count()
    for _ in range(5):
        threads = WorkerPool(3)
        assert threads.map([lambda: 1, lambda: 2, lambda: 3]) == [1, 2, 3]
    del threads
    until = time.monotonic() + 20
    while threading.active_count() > before and time.monotonic() < until:
        time.sleep(0.01)
    assert threading.active_count() <= before


def test_the_error_of_a_task_is_raised_and_the_rest_is_left():
    threads = WorkerPool(2)
    ran = []

    def bad() -> None:
        raise ValueError("no")

    try:
        with pytest.raises(ValueError, match="no"):
            threads.map([bad, *[partial(ran.append, k) for k in range(1000)]])
        assert threads.map([lambda: 1, lambda: 2]) == [1, 2]  # still of use
    finally:
        threads.close()


def test_closed_threads_refuse_what_a_running_task_asks_for():
    threads = WorkerPool(2)
    threads.close()
    with pytest.raises(RuntimeError):
        threads.map([lambda: 1, lambda: 2])


def test_the_longest_starts_first_and_the_answers_keep_their_order() -> None:
    started: list[int] = []

    def task(i: int) -> int:
        started.append(i)
        time.sleep(0.01)
        return i

    threads = WorkerPool(2)
    assert threads.map([partial(task, i) for i in range(5)], [1.0, 3.0, 9.0, 2.0, 5.0]) == list(range(5))
    threads.close()
    assert set(started[:2]) == {2, 4}
    assert started[-1] == 0


def test_work_is_counted_on_every_thread() -> None:
    threads = WorkerPool(2)
    counted = Counted(threads)
    try:
        counted.run([partial(count_work, k) for k in (5, 5, 7)])
    finally:
        threads.close()
    assert counted.work == 17
