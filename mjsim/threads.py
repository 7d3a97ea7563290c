"""Threads of the linear algebra: where matrices are small they cost more than they bring."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

__all__ = ["one_thread"]

P = ParamSpec("P")
R = TypeVar("R")


def one_thread(work: Callable[P, R]) -> Callable[P, R]:
    """A function that runs with one thread of the BLAS in this process, and gives back the number that there was."""

    @functools.wraps(work)
    def limited(*args: P.args, **more: P.kwargs) -> R:
        with threadpool_limits(1, "blas"):
            return work(*args, **more)

    return limited
