"""A slow error of the model as the rival of what repeats a few times over the travel, where the error is the model's own.

An order must stand out of those beside it; one of few periods has none beside it, or too few. It has to take most of the squared
error, on both recordings.
"""

from __future__ import annotations

import math

from diagnose.evidence.context import Context
from diagnose.evidence.force_orders import few_periods
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto
from diagnose.thresholds import NEARLY_ALL
from mjsim.effects import Effect

__all__ = ["no_slow_error"]


def no_slow_error(context: Context, pair: Pair) -> Outcome:
    """Refuse an effect of few periods over the travel that takes no more of the error than a slow error might."""
    if context.fitter.noise.absolute:
        return PASS
    before, after = pair.before, pair.after
    orders = {e: e.values["cycles_per_rev"] for e in after.effects if e.key not in before.key and "cycles_per_rev" in e.values}
    if not any(_unsure(context, e, n) for e, n in orders.items()):
        return PASS
    share = min(1.0 - after.chi2 / before.chi2, context.compared(before, after).relative_gain)
    return Veto("few_periods", {"share": share, "needed": NEARLY_ALL}) if share < NEARLY_ALL else PASS


def _unsure(context: Context, effect: Effect, order: float) -> bool:
    """Whether an order has too few periods to stand out of others, or did not stand out over all orders."""
    turn = 2 * math.pi / context.fitter.scales[type(effect).angle_of or effect.place].travel
    return order < few_periods() * turn or any(abs(order - n) < turn for n in context.fitter.problem.unsure)
