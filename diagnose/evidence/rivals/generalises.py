"""Held-out data as the judge: a material gain that is no chance."""

from __future__ import annotations

from diagnose.evidence.context import Context
from diagnose.evidence.held_out import Comparison
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto

__all__ = ["generalises", "significant"]


def significant(context: Context, comparison: Comparison, hypotheses: int) -> bool:
    """Whether a held-out gain is material, and its p-value, corrected for the hypotheses, small."""
    prices = context.prices
    return comparison.relative_gain > prices.material and comparison.p_value * hypotheses < prices.p_enter


def generalises(context: Context, pair: Pair) -> Outcome:
    """Refuse what does not gain on held-out recordings, nor on held-out stretches where these cannot tell."""
    held = context.compared(pair.before, pair.after)
    if significant(context, held, pair.hypotheses):
        return PASS
    blocks = context.compared_in_blocks(pair.before, pair.after)
    if blocks is not None and significant(context, blocks, pair.hypotheses):
        return PASS
    judged = held if blocks is None else blocks
    return Veto(
        "held_out",
        {
            "relative_gain": judged.relative_gain, "needed": context.prices.material,
            "p_value": min(1.0, judged.p_value * pair.hypotheses), "largest_p_value": context.prices.p_enter,
        },
    )  # fmt: skip
