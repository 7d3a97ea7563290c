"""What a diagnosis is at, for whoever waits: stage, rivals left, the best so far, about how long it still takes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from diagnose.thresholds import BEGUN, SCREENED, TAIL

__all__ = ["Progress", "Step"]


@dataclass(frozen=True)
class Step:
    """One moment: the stage and what is done in it; rivals still to be fitted there; the best structure so far; time left [s].

    ``left`` and ``seconds`` are None where they are not known; the time is a guess from the rounds that have been, no promise.
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
    """To one digit that a guess can bear."""
    for step in (1, 2, 5, 10, 20, 30):
        if seconds < 8 * step:
            return max(step, step * round(seconds / step))
    return 60 * max(1, round(seconds / 60))


class Progress:
    """Takes notes from a running diagnosis and tells each change; safe to call from several threads."""

    def __init__(self, tell: Callable[[Step], None] = lambda _: None, clock: Callable[[], float] = time.monotonic) -> None:
        self._tell, self._clock = tell, clock
        self._lock = threading.Lock()
        self._stage, self._what, self._best = "", "", ""
        self._left: int | None = None
        self._total = 0
        self._part = 0.0  # of the present round
        self._reach = 0.0  # where the present stretch of the round ends
        self._began = clock()
        self._rounds: list[float] = []
        self._more = 0

    def stage(self, name: str, what: str = "") -> None:
        """A new stage, in which no rivals are counted until they are named."""
        with self._lock:
            self._stage, self._what, self._left = name, what, None
            self._part = self._reach = 0.0
        self._say()

    def begin_round(self, more: int) -> None:
        """A round of the search; ``more``: so many are to be expected after it."""
        with self._lock:
            self._more = more
            self._part, self._reach, self._left = 0.0, SCREENED, None
            self._began = self._clock()

    def end_round(self) -> None:
        """The round is over; its length is what others are guessed by."""
        with self._lock:
            self._rounds.append(self._clock() - self._began)
            self._left = None

    def rivals(self, count: int) -> None:
        """So many rivals are fitted next: the many that begin, or the few that go on."""
        with self._lock:
            self._part = self._reach
            self._reach = BEGUN if self._part < BEGUN else self._part + 0.5 * (1.0 - self._part)
            self._left = self._total = count
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
        """Guess: the rest of this round by its own pace, then rounds like the mean one, then the tail."""
        if self._left is None or not self._total:
            return None
        part = self._part + (self._reach - self._part) * (1 - self._left / self._total)
        if part < 0.2:
            return None
        whole = (self._clock() - self._began) / part
        mean = (sum(self._rounds) + whole) / (len(self._rounds) + 1)
        return (1 - part) * whole + (self._more + TAIL) * mean

    def _say(self) -> None:
        with self._lock:
            step = Step(self._stage, self._what, self._left, self._best, self._seconds())
        self._tell(step)
