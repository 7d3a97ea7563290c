"""A servo's answer to unknown torques as a rival, where the error is the model's own.

A servo answers a torque that no model knows of, late and in proportion: what the command lacks then looks like a delay, a lag, a
dead zone or a spring, and a slow one like an offset. A law of which the data leave a size open is one of those as well: bristles
that never slide are a spring.
"""

from __future__ import annotations

from collections.abc import Mapping

from diagnose.evidence.context import Context
from diagnose.evidence.intervals import open_sizes
from diagnose.evidence.outcome import PASS, Outcome, Pair, Veto
from diagnose.fit.fitted import Fitted
from diagnose.thresholds import MOST

__all__ = ["no_answer_of_a_servo", "size_is_open"]

IMITATED = {"signal", "coupling", "structure", "offset"}  # families of effects that look like such an answer


def no_answer_of_a_servo(context: Context, pair: Pair) -> Outcome:
    """Refuse an effect that looks like a servo's answer unless it takes more of the squared error than that can."""
    if context.fitter.noise.absolute:
        return PASS
    before, after = pair.before, pair.after
    added = [e for e in after.effects if e.key not in before.key]
    alike = any(type(e).family in IMITATED for e in added)
    if not alike and not size_is_open(context, after, {e.key: e.amplitudes for e in added}):
        return PASS
    share = min(1.0 - after.chi2 / before.chi2, context.compared(before, after).relative_gain)
    return Veto("servo", {"share": share, "needed": MOST}) if share < MOST else PASS


def size_is_open(context: Context, f: Fitted, sizes: Mapping[str, tuple[str, ...]]) -> bool:
    """Whether the 95 % interval of one of the sizes of effects, by key, holds zero."""
    return bool(open_sizes(f, context.fitter.noise, sizes))
