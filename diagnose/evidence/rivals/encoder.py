"""An encoder that errs over its turn, as the rival of one added effect.

At whole orders of its turn it may err beside any effect, which must gain there too; at whatever order a position-locked effect
has, it is that effect's rival.
"""

from __future__ import annotations

from diagnose.evidence.context import Context
from diagnose.evidence.encoder import encoder_gain, gain_with_encoder_error
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto
from diagnose.thresholds import MATERIAL

__all__ = ["no_error_of_the_encoder"]


def no_error_of_the_encoder(context: Context, pair: Pair) -> Outcome:
    """Refuse an effect that gains no more than the encoder's error of the same order would, or nothing beside such errors."""
    before, after = pair.before, pair.after
    new = [e for e in after.effects if e.key not in before.key]
    if len(new) != 1 or len(after.key) != len(before.key) + 1 or not context.fitter.noise.absolute:
        return PASS
    entry, gain = context.prices.entry, before.chi2 - after.chi2
    asked = (before.key, before.chi2, new[0], after.chi2)
    if asked not in context.memo.encoder:
        own = encoder_gain(context.fitter, before, new[0])
        by_order = own > gain - max(entry, MATERIAL * gain)
        context.memo.encoder[asked] = own, entry if by_order else gain_with_encoder_error(context.fitter, before, after)
    own, beside = context.memo.encoder[asked]
    if own > gain - max(entry, MATERIAL * gain):
        return Veto("encoder", {"gain": gain, "needed": own + max(entry, MATERIAL * gain)})
    return Veto("encoder", {"gain": beside, "needed": entry}) if beside < entry else PASS
