"""Only effects whose sizes the data determine are named.

An effect whose size has an interval that contains zero gives way to a simpler form of it, to its limit, or to nothing, whichever
the criterion prefers. Where the criterion asks for it nevertheless, it stays out: what it explained is then left unexplained.
"""

from __future__ import annotations

from collections.abc import Callable

from diagnose.evidence.intervals import Open, open_sizes
from diagnose.fit.fitted import Fitted
from diagnose.structure.search import Search

__all__ = ["determined"]


def determined(search: Search, best: Fitted) -> tuple[Fitted, tuple[str, ...]]:
    """The best structure without undetermined effects, and a sentence for each that was left out or replaced."""
    said: list[str] = []
    for _ in range(len(best.effects) * 3):
        found = open_sizes(best, search.fitter.noise) if best.ok else ()
        if not found:
            break
        first = found[0]
        poorer = _poorer(search, best, first)
        if poorer is None:
            break
        said.append(_sentence(search, best, poorer, first))
        best = search.fitter.refined(search.polish(poorer))
    return best, tuple(said)


def _poorer(search: Search, best: Fitted, undetermined: Open) -> Fitted | None:
    """The structure of the least criterion without the undetermined effect; None where none can be fitted."""
    effect = undetermined.effect
    fits: list[Callable[[], Fitted]] = [lambda: search.reduction.without(best, effect), *search.reduction.simpler(best, effect)]
    rivals = [fit() for fit in fits]
    rivals += [f for f in search.starts.limits(best) if effect.key not in f.key]
    usable = [f for f in rivals if f.ok and effect.key not in f.key and search.state.admitted([e.id for e in f.effects])]
    return min(usable, key=search.criterion, default=None)


def _sentence(search: Search, best: Fitted, poorer: Fitted, undetermined: Open) -> str:
    effect, (low, high) = undetermined.effect, undetermined.ci95
    name = effect.name().replace("_", " ").capitalize()
    instead = [e.name().replace("_", " ") for e in poorer.effects if e.key not in best.key]
    place = f"{' and '.join(instead)} is fitted in its place" if instead else "it is left out"
    return (
        f"{name} at the {effect.place} is not named: the 95 % interval of its {undetermined.name}, [{low:.3g}, {high:.3g}], "
        f"contains zero; {place}."
    )
