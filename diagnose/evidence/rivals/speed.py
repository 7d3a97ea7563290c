"""Friction of another law as the rival of what repeats over the angle: a function of the speed alone.

Over a periodic motion the speed follows from the angle, and waves of a high order then follow the error of a law of friction.
"""

from __future__ import annotations

import math

from diagnose.evidence.context import Context
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto
from diagnose.evidence.speed import left_beside_speed

__all__ = ["no_function_of_the_speed"]


def no_function_of_the_speed(context: Context, pair: Pair) -> Outcome:
    """Refuse a position-locked effect whose gain of C is below ``entry`` beside a function of the speed."""
    before, after = pair.before, pair.after
    if not any("cycles_per_rev" in e.values for e in after.effects if e.key not in before.key):
        return PASS
    asked = (before.key, before.chi2, after.key, after.chi2)
    if asked not in context.memo.speed:
        left = left_beside_speed(context.fitter, before, after)
        context.memo.speed[asked] = math.inf if left is None else _gain(context, pair, *left)
    gain, needed = context.memo.speed[asked], context.prices.entry
    return Veto("speed", {"gain": gain, "needed": needed}) if gain < needed else PASS


def _gain(context: Context, pair: Pair, before: float, after: float) -> float:
    """How far C falls between two chi-squares, by the samples that distinguish the pair."""
    between = context.share_between
    n = pair.before.n * (context.effective if between is None else between(pair.before, pair.after))
    numbers = pair.after.hypothesis.size - pair.before.hypothesis.size
    return n * math.log(max(before, 1e-300) / max(after, 1e-300)) - context.prices.price * numbers
