"""Only effects that the data show, also the held-out ones, and whose sizes they determine, are named.

An effect whose size has an interval that contains zero, or with a number that the recording cannot show (`Effect.admissible`),
gives way to a simpler form of it, to its limit, to a structure without it, or to nothing, whichever the criterion prefers. Where
the criterion asks for it nevertheless, it stays out: what it explained is then left unexplained. So does an effect by which the
held-out error falls no more than it may by chance under the best of as many hypotheses as were tried (Bonferroni), and one that
cannot be told from an effect that is too small to be shown: a drive that acts half a millisecond late is no dead band.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial

from diagnose.evidence.admissible import Outside, out_of_range
from diagnose.evidence.intervals import Open, open_sizes
from diagnose.evidence.outcome import Veto
from diagnose.fit.fitted import Fitted
from diagnose.fit.least_squares import Status
from diagnose.structure.search import Search
from diagnose.structure.state import Refusal
from diagnose.thresholds import EQUIVALENT, FAMILY
from diagnose.verdict.decide import p_values
from mjsim.effects import Effect

__all__ = ["determined"]


def determined(search: Search, best: Fitted) -> tuple[Fitted, tuple[str, ...]]:
    """The best structure without undetermined effects, and a sentence for each that was left out or replaced."""
    said: list[str] = []
    refused: set[str] = set()
    small: dict[str, Outside] = {}
    while True:  # each turn refuses an effect for good, and there are finitely many
        found: list[Open | Outside | Chance | Alike] = [*out_of_range(best, search.fitter)] if best.ok else []
        small |= {o.effect.key: o for o in found if isinstance(o, Outside) and o.range.is_below}
        found += open_sizes(best, search.fitter.noise) if best.ok else ()
        found += () if found else _by_chance(search, best)
        found += () if found else _alike(search, best, small)
        if not found:
            break
        first = found[0]
        refused.add(first.effect.key)
        poorer = _poorer(search, best, first, refused)
        if poorer is None:
            break
        said.append(_sentence(best, poorer, first))
        if isinstance(first, Chance):
            _refuse(search, poorer, first)
        best = search.fitter.refined(search.polish(poorer))
    return best, tuple(said)


@dataclass(frozen=True)
class Chance:
    """An effect without which the held-out error may be as low by chance: its p-value over all hypotheses."""

    effect: Effect
    p_value: float
    hypotheses: int


@dataclass(frozen=True)
class Alike:
    """An effect in whose place one that is too small to be shown explains as much."""

    effect: Effect
    small: Outside


def _alike(search: Search, best: Fitted, small: Mapping[str, Outside]) -> list[Alike]:
    """Effects of a structure that cannot be told from those that were refused for being small, by structure."""
    found = []
    for effect in best.effects:
        rest = set(best.key) - {effect.key}
        for key, one in small.items():
            other = search.fits.get(tuple(sorted(rest | {key})))
            if other is not None and search.context.ahead(best, other) <= EQUIVALENT:
                found.append(Alike(effect, one))
    return found


def _by_chance(search: Search, best: Fitted) -> list[Chance]:
    """The effects of a structure whose gain on held-out data may be chance, the likeliest first."""
    if not best.ok or not best.effects:
        return []
    fewer = search.fitter.map([partial(search.pruning.without, best, effect) for effect in best.effects])
    tried = max(1, search.tested)
    found = [
        Chance(effect, min(1.0, tried * p_values(search, poorer, best)[0]), tried)
        for effect, poorer in zip(best.effects, fewer, strict=True)
    ]
    return sorted((c for c in found if c.p_value > FAMILY), key=lambda c: -c.p_value)


def _refuse(search: Search, poorer: Fitted, found: Chance) -> None:
    """Write down why structures with an effect are not the answer."""
    veto = Veto("chance", {"p_value": found.p_value, "hypotheses": float(found.hypotheses), "largest_p_value": FAMILY})
    for key in search.fits:
        if found.effect.key in key:
            search.state.refusals.setdefault(key, Refusal(key, poorer.key, veto))


def _poorer(search: Search, best: Fitted, found: Open | Outside | Chance | Alike, refused: Collection[str]) -> Fitted | None:
    """The structure of the least criterion without the effect, or any that was refused; None where none can be fitted.

    In place of one whose numbers the recording cannot show a rival of the search stands as well, if it is significant.
    """
    effect = found.effect
    pruning = search.pruning
    fits: list[Callable[[], Fitted]] = [
        lambda: pruning.without(best, effect), *pruning.simplified(best, effect), *pruning.limits(best, effect)
    ]  # fmt: skip
    rivals = [fit() for fit in fits]
    usable = [f for f in rivals if f.ok and not set(refused) & set(f.key) and search.state.admitted([e.id for e in f.effects])]
    least = min(usable, key=search.criterion, default=None)
    if least is None or not isinstance(found, Outside):
        return least
    better = [f for f in _admissible(search, refused, least) if search.criterion(f) < search.criterion(least)]
    for f in sorted(better, key=search.criterion):
        if search.significance.significant(search.nominal(), f):
            return f
    return least


def _admissible(search: Search, refused: Collection[str], least: Fitted) -> list[Fitted]:
    """Structures of the search without the effects that were refused, whose numbers the recording can show.

    Those that may come to fit better than ``least`` are fitted to convergence: the search drops a rival that is behind after a
    few iterations, and these were behind the effect alone.
    """
    nominal, floor = search.nominal(), search.context.gain(search.nominal(), least)
    others = [f for f in search.fits.values() if f.ok and f.effects and not set(refused) & set(f.key)]
    others = sorted((f for f in others if not out_of_range(f, search.fitter)), key=search.criterion)[: search.options.width]
    fits = [
        search.polish(f) if f.fit.status is Status.BUDGET and search.halving.may_gain(nominal, f, floor) else f for f in others
    ]  # fmt: skip
    return [f for f in fits if not out_of_range(f, search.fitter)]


def _sentence(best: Fitted, poorer: Fitted, found: Open | Outside | Chance | Alike) -> str:
    name = found.effect.name().replace("_", " ").capitalize()
    instead = [e.name().replace("_", " ") for e in poorer.effects if e.key not in best.key]
    place = f"{' and '.join(instead)} is fitted in its place" if instead else "it is left out"
    if isinstance(found, Chance):
        why = f"over {found.hypotheses} hypotheses its gain on held-out data has p = {found.p_value:.2g}, which is chance"
    elif isinstance(found, Alike):
        r, other = found.small.range, found.small.effect.name().replace("_", " ")
        why = (
            f"{other} explains as much by a {r.what} of {r.value:.3g}, which is too small to be shown: below {r.low:.3g}, {r.why}"
        )
    elif isinstance(found, Open):
        low, high = found.ci95
        why = f"the 95 % interval of its {found.name}, [{low:.3g}, {high:.3g}], contains zero"
    else:
        r = found.range
        why = f"its {r.what} of {r.value:.3g} lies outside {r.low:.3g} to {r.high:.3g}, {r.why}"
    return f"{name} at the {found.effect.place} is not named: {why}; {place}."
