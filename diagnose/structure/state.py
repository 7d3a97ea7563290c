"""What the parts of a search share: the fits so far, what may still be tried, and what it may take."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from diagnose.evidence.context import Context
from diagnose.evidence.outcome import Veto
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.pool import Key, Pool
from diagnose.progress import Progress
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import Candidate, Screened

__all__ = ["Refusal", "State"]


@dataclass(frozen=True)
class Refusal:
    """A structure that a test refused against another one."""

    structure: Key
    against: Key
    veto: Veto


@dataclass
class State:
    """State of a search.

    candidates: effects and places that it considers; only_beside: an effect that may only stand beside another, and that one;
    failed: why candidates were not fitted; screened: what the candidates promised beside a structure; tested: hypotheses so far;
    refusals: by structure, the last test that refused it; tried: what was tried by the present weights; warm: structures that
    were fitted from a richer one's numbers; horizons: how often a structure was fitted over growing horizons.
    """

    context: Context
    options: SearchOptions
    progress: Progress = field(default_factory=Progress)
    candidates: tuple[Candidate, ...] = ()
    only_beside: Mapping[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    screened: dict[Key, list[Screened]] = field(default_factory=dict)
    tested: int = 0
    refusals: dict[Key, Refusal] = field(default_factory=dict)
    tried: set[tuple[object, ...]] = field(default_factory=set)
    warm: set[tuple[object, ...]] = field(default_factory=set)
    horizons: dict[Key, int] = field(default_factory=dict)
    released: int = 0

    def __post_init__(self) -> None:
        self._began = time.monotonic()
        self._runs = self.fitter.runs

    @property
    def fitter(self) -> Fitter:
        """The fitter by the present weights."""
        return self.context.fitter

    @property
    def pool(self) -> Pool:
        """The best fit of each structure by the present weights."""
        return self.context.pool

    def consider(self, candidates: Sequence[Candidate]) -> None:
        """Search among these."""
        self.candidates = tuple(candidates)
        self.context.candidates = len(self.candidates)

    def keep(self, f: Fitted) -> None:
        """Put a fit in the pool, unless a better one of its structure is there."""
        self.pool.keep(f)

    def spent(self) -> bool:
        """Whether what this stretch of the search may take (the same on every machine), or the whole diagnosis, is used up."""
        return self.left() < 0 or self.late()

    def left(self) -> float:
        """How many simulations may still be taken."""
        return min(self.options.runs - (self.fitter.runs - self._runs), self.fitter.most_runs - self.fitter.runs)

    def late(self) -> bool:
        """Whether what the whole diagnosis may take is used up."""
        return self.fitter.spent or time.monotonic() - self._began > self.options.seconds

    def charge_half(self, since: int) -> None:
        """Count what was simulated ``since`` (in runs) at half its cost."""
        self._runs += (self.fitter.runs - since) // 2

    def grant_half(self) -> None:
        """Leave half of the budget at least for what follows."""
        self._runs = max(self._runs, self.fitter.runs - self.options.runs // 2)

    def admitted(self, ids: Sequence[str]) -> bool:
        """Whether every effect that may only stand beside another one does."""
        return all(name not in ids or other in ids for name, other in self.only_beside.items())
