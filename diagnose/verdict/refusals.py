"""Why the leading rivals are not the answer."""

from __future__ import annotations

from diagnose.fit.fitted import Fitted
from diagnose.result import Refused
from diagnose.structure.search import Search
from diagnose.thresholds import LEADING

__all__ = ["refusals"]


def refusals(search: Search, best: Fitted) -> tuple[Refused, ...]:
    """For each of the leading rivals the test that refused it, lowest criterion first.

    A rival that no test was asked about is not good enough by the criterion C: "gain" is how far its C lies below that of the
    answer, "needed" how far it must. Nothing is simulated for this.
    """
    ranked = sorted((f for f in search.pool.values() if f.key != best.key), key=search.criterion)[:LEADING]
    return tuple(_refused(search, best, f) for f in ranked)


def _refused(search: Search, best: Fitted, rival: Fitted) -> Refused:
    known = search.state.refusals.get(rival.key)
    if known is not None:
        return Refused(rival.key, known.against, known.veto.code, known.veto.numbers)
    gain, needed = search.criterion(best) - search.criterion(rival), search.selection.needed(rival, best)
    return Refused(rival.key, best.key, "criterion", {"gain": gain, "needed": needed})
