"""The gain in the criterion, with what the held-out data add to it where the error is the model's own."""

from __future__ import annotations

from diagnose.evidence.context import Context
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto

__all__ = ["gains"]


def gains(context: Context, pair: Pair) -> Outcome:
    """Refuse a gain of C below ``entry``."""
    gain = context.gain(pair.before, pair.after) + context.unseen_gain(pair.before, pair.after)
    needed = context.prices.entry
    return Veto("gain", {"gain": gain, "needed": needed}) if gain < needed else PASS
