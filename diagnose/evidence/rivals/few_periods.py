"""A slow error of the model as the rival of what repeats a few times over the travel, where the error is the model's own.

An order must stand out of those beside it; one of so few periods has none beside it. It has to take most of the squared error, on
both recordings.
"""

from __future__ import annotations

import math

from diagnose.evidence.context import Context
from diagnose.evidence.force_orders import few_periods
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto
from diagnose.thresholds import NEARLY_ALL

__all__ = ["no_slow_error"]


def no_slow_error(context: Context, pair: Pair) -> Outcome:
    """Refuse an effect of few periods over the travel that takes no more of the error than a slow error might."""
    if context.fitter.noise.absolute:
        return PASS
    before, after = pair.before, pair.after
    orders = {e: e.values["cycles_per_rev"] for e in after.effects if e.key not in before.key and "cycles_per_rev" in e.values}
    scales = context.fitter.scales
    if not any(n * scales[type(e).angle_of or e.place].travel < 2 * math.pi * few_periods() for e, n in orders.items()):
        return PASS
    share = min(1.0 - after.chi2 / before.chi2, context.compared(before, after).relative_gain)
    return Veto("few_periods", {"share": share, "needed": NEARLY_ALL}) if share < NEARLY_ALL else PASS
