"""Progress of a diagnosis: stage, rivals left in it, the best so far, about how long the stage still takes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Progress", "Step"]


@dataclass(frozen=True)
class Step:
    """One moment: the stage and what is done in it; rivals still to be fitted there; the best structure so far; time left [s].

    ``left`` and ``seconds`` are None where they are not known. The time is that of the stage, by the pace of the rivals so far.
    """

    stage: str
    what: str = ""
    left: int | None = None
    best: str = ""
    seconds: float | None = None

    def __str__(self) -> str:
        """As one line."""
        parts = [f"{self.stage}: {self.what}" if self.what else self.stage]
        if self.left is not None:
            parts.append(f"{self.left} rivals left" if self.left != 1 else "1 rival left")
        if self.best:
            parts.append(f"best so far {self.best}")
        if self.seconds is not None:
            parts.append(f"about {_rounded(self.seconds)} s left")
        return "; ".join(parts)


def _rounded(seconds: float) -> int:
    """To one significant digit or so."""
    for step in (1, 2, 5, 10, 20, 30):
        if seconds < 8 * step:
            return max(step, step * round(seconds / step))
    return 60 * max(1, round(seconds / 60))


class Progress:
    """Reports each change of a running diagnosis; safe to call from several threads."""

    def __init__(self, tell: Callable[[Step], None] = lambda _: None, clock: Callable[[], float] = time.monotonic) -> None:
        self._tell, self._clock = tell, clock
        self._lock = threading.Lock()
        self._stage, self._what, self._best = "", "", ""
        self._left: int | None = None
        self._total = 0
        self._start = clock()

    def stage(self, name: str, what: str = "") -> None:
        """A new stage, in which no rivals are counted until they are named."""
        with self._lock:
            self._stage, self._what, self._left = name, what, None
        self._say()

    def rivals(self, count: int) -> None:
        """So many rivals are fitted next."""
        with self._lock:
            self._left = self._total = count
            self._start = self._clock()
        self._say()

    def rival(self) -> None:
        """One of them is done."""
        with self._lock:
            if self._left:
                self._left -= 1
        self._say()

    def best(self, text: str) -> None:
        """The best structure so far."""
        with self._lock:
            self._best = text
        self._say()

    def _seconds(self) -> float | None:
        """The rivals left by the pace of those that are done."""
        if not self._left or self._left == self._total:
            return None
        return (self._clock() - self._start) * self._left / (self._total - self._left)

    def _say(self) -> None:
        with self._lock:
            step = Step(self._stage, self._what, self._left, self._best, self._seconds())
        self._tell(step)
