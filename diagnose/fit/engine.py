"""What fits share whatever the problem: threads, the ledger on disk, the count of simulations, and what was worked out once."""

from __future__ import annotations

import math
import threading
import time
from typing import Any, final

from diagnose.fit.ledger import Ledger
from diagnose.fit.workers import WorkerPool

__all__ = ["Counter", "Engine"]


@final
class Counter:
    """Work in products of a step, counted by several threads."""

    def __init__(self) -> None:
        self.work = 0
        self._lock = threading.Lock()

    def add(self, work: int) -> None:
        """Count more."""
        with self._lock:
            self.work += work

    def drain(self) -> int:
        """What was counted, and count from zero again."""
        with self._lock:
            work, self.work = self.work, 0
            return work


@final
class Engine:
    """Threads, ledger and budget.

    unit: products of a step in a run of the nominal model with friction on all estimation recordings; most_runs: such runs that
    may be taken; until: end of the budget of time, by the monotonic clock [s];
    own, pooled, observed: numbers of held-out recordings, fits to all recordings, fits under an observer gain.
    """

    def __init__(self, threads: WorkerPool, unit: int, ledger: Ledger | None = None, counter: Counter | None = None) -> None:
        self.threads, self.unit, self.ledger = threads, unit, ledger
        self.counter = counter or Counter()
        self.most_runs = math.inf
        self.until = math.inf
        self.closed = False
        self.own: dict[tuple[object, ...], Any] = {}
        self.pooled: dict[tuple[object, ...], Any] = {}
        self.observed: dict[tuple[object, ...], Any] = {}

    def related(self, *, remembers: bool = False, counts_here: bool = False) -> Engine:
        """An engine for a related problem on the same threads, with no budget of its own.

        ``remembers``: its fits go into the ledger as well; ``counts_here``: its work counts as this one's.
        """
        return Engine(
            self.threads, self.unit, self.ledger if remembers else None, self.counter if counts_here else None
        )  # fmt: skip

    @property
    def runs(self) -> int:
        """What was simulated so far, in runs of the nominal model with friction on all estimation recordings."""
        return self.counter.work // self.unit

    @property
    def spent(self) -> bool:
        """Whether the budget is used up: the runs that a diagnosis may take (the same on every machine, with any number of
        threads), or its time."""
        return self.runs > self.most_runs or self.late

    @property
    def late(self) -> bool:
        """Whether the budget of time is used up."""
        return time.monotonic() > self.until

    def close(self) -> None:
        """Stop the threads: what they are at comes to nothing, and is not remembered."""
        self.closed = True
        self.threads.close()
