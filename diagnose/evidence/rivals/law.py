"""The error of an assumed law as a rival: what an effect gains may be what another law of the first one still misses."""

from __future__ import annotations

from diagnose.evidence.context import Context
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto

__all__ = ["no_error_of_a_law"]


def no_error_of_a_law(context: Context, pair: Pair) -> Outcome:
    """Refuse an added effect whose gain of chi-square the error of a law in the poorer structure may give."""
    gain, needed = pair.before.chi2 - pair.after.chi2, context.law_error(pair.before)
    return Veto("law", {"gain": gain, "needed": needed}) if pair.nested and gain < needed else PASS
