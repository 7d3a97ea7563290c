"""What the parts of a search share: the fits so far, the candidates, the refusals and the budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from diagnose.evidence.context import Context
from diagnose.evidence.outcome import Veto
from diagnose.fit.fits import Fits, Key
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.progress import Progress
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import Candidate

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

    candidates: effects and places that it considers; requires: an effect that may only stand beside another, and that one;
    failed: why candidates were not fitted; tested: hypotheses so far; refusals: by structure, the last test that refused it;
    tried: moves that were made, each with the structure and the error from which it was made; late: whether the budget of time
    was used up when the search ended.
    """

    context: Context
    options: SearchOptions
    progress: Progress = field(default_factory=Progress)
    candidates: tuple[Candidate, ...] = ()
    requires: Mapping[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    tested: int = 0
    refusals: dict[Key, Refusal] = field(default_factory=dict)
    tried: set[tuple[object, ...]] = field(default_factory=set)
    late: bool = False

    @property
    def fitter(self) -> Fitter:
        """The fitter by the present weights."""
        return self.context.fitter

    @property
    def fits(self) -> Fits:
        """The best fit of each structure."""
        return self.context.fits

    def consider(self, candidates: Sequence[Candidate]) -> None:
        """Search among these."""
        self.candidates = tuple(candidates)
        self.context.candidates = len(self.candidates)

    def keep(self, f: Fitted) -> None:
        """Record a fit; it stands for its structure unless a better one does."""
        self.fits.keep(f)

    def spent(self) -> bool:
        """Whether the budget is used up, in simulations (the same on every machine) or in time."""
        return self.fitter.spent

    def once(self, *move: object) -> bool:
        """Whether a move was not made before; it counts as made from now on."""
        if move in self.tried:
            return False
        self.tried.add(move)
        return True

    def admitted(self, ids: Sequence[str]) -> bool:
        """Whether every effect that may only stand beside another one does."""
        return all(name not in ids or other in ids for name, other in self.requires.items())
