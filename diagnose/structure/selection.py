"""The incumbent: the structure of the lowest criterion that is significant against the present one."""

from __future__ import annotations

from dataclasses import dataclass

from diagnose.fit.fitted import Fitted
from diagnose.structure.graph import refines
from diagnose.structure.significance import Significance
from diagnose.structure.state import State

__all__ = ["Selection"]


@dataclass
class Selection:
    """Selects among the structures of a pool."""

    state: State
    significance: Significance

    def best(self, current: Fitted) -> Fitted:
        """The structure with the best criterion among those that are significant against the current one."""
        context, fits, attempt = self.state.context, self.state.fits, 0
        for f in sorted(fits.values(), key=context.criterion):
            current = fits.best(current)
            larger = self.larger(f, current)
            unseen = context.unseen_gain(current, f) if larger and f.key != current.key else 0.0
            if f.key == current.key or context.ahead(f, current) + unseen <= self.needed(f, current):
                continue
            attempt += larger
            if self._wins(f, current, attempt, larger=larger):
                return f
        return fits.best(current)

    def needed(self, f: Fitted, current: Fitted) -> float:
        """How far C of a structure must lie below that of the current one for the evidence to be asked."""
        return self.state.context.prices.entry if self.larger(f, current) else 0.0

    def larger(self, f: Fitted, current: Fitted) -> bool:
        """Whether a structure says more than the current one: more effects, a refinement, or (by held-out data) more numbers."""
        larger = len(f.effects) > len(current.effects) or refines(f, current)
        if self.state.context.share_between is None:
            return larger
        return larger or f.hypothesis.size > current.hypothesis.size

    def _wins(self, f: Fitted, current: Fitted, attempt: int, *, larger: bool) -> bool:
        if larger:
            return self.significance.significant(current, f, attempt)
        return self.significance.dominates(f, current) and not self.significance.contradicted(f, current)
