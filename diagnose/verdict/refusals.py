"""Why the leading rivals are not the answer."""

from __future__ import annotations

from collections.abc import Sequence

from diagnose.fit.fitted import Fitted
from diagnose.result import Refused
from diagnose.structure.search import Search
from diagnose.thresholds import HALVINGS, LEADING

__all__ = ["refusals", "refused_in_words"]

_TESTS = {
    "gain": "its gain in the criterion, {gain:.3g}, is less than {needed:.3g}",
    "quantisation": (
        "without it the errors stay within half a step of the encoder: {beyond:.2g} of the variance of a step lies beyond "
        "({needed:.2g} is needed)"
    ),
    "law": "its gain, {gain:.3g}, may be the error of a law ({needed:.3g})",
    "encoder": "an encoder that errs over its turn does as much (gain beside it {gain:.3g}, needed {needed:.3g})",
    "events": "it gains by the moment of an event (gain apart from that {gain:.3g}, needed {needed:.3g})",
    "few_periods": "a law of so few periods takes {share:.0%} of the squared error, {needed:.0%} is needed",
    "speed": "a function of the speed does as much (gain beside it {gain:.3g}, needed {needed:.3g})",
    "servo": "a servo's answer to unknown torques does as much ({share:.0%} of the squared error, {needed:.0%} is needed)",
    "chance": "over {hypotheses:.0f} hypotheses its gain on held-out data has p = {p_value:.2g} (needed: {largest_p_value:.2g})",
    "held_out": (
        "it changes the held-out squared error by {change:+.1%} with p = {p_value:.2g} (needed: {least:+.2%}, p below "
        "{largest_p_value:.2g})"
    ),
}


def refusals(search: Search, best: Fitted) -> tuple[Refused, ...]:
    """For each of the leading rivals the test that refused it, lowest criterion first.

    A rival that no test was asked about is not good enough by the criterion C: "gain" is how far its C lies below that of the
    answer, "needed" how far it must. Nothing is simulated for this.
    """
    ranked = sorted((f for f in search.fits.values() if f.key != best.key), key=search.criterion)[: HALVINGS[0][0]]
    return tuple(_refused(search, best, f) for f in ranked)


def refused_in_words(found: Sequence[Refused]) -> tuple[str, ...]:
    """A sentence for each rival that a test refused although it may be ahead by the criterion, at most `LEADING`."""
    said = []
    for r in found:
        if r.test not in _TESTS:
            continue
        n = dict(r.numbers)
        if r.test == "held_out":
            n |= {"change": -n["relative_gain"], "least": -n["needed"]}
        name = " and ".join(key.partition("@")[0].replace("_", " ") + f" at the {key.partition('@')[2]}" for key in r.effects)
        said.append(f"{name[:1].upper()}{name[1:]} is refused: {_TESTS[r.test].format(**n)}.")
    return tuple(said[:LEADING])


def _refused(search: Search, best: Fitted, rival: Fitted) -> Refused:
    known = search.state.refusals.get(rival.key)
    if known is not None:
        return Refused(rival.key, known.against, known.veto.code, known.veto.numbers)
    gain, needed = search.criterion(best) - search.criterion(rival), search.selection.needed(rival, best)
    return Refused(rival.key, best.key, "criterion", {"gain": gain, "needed": needed})
