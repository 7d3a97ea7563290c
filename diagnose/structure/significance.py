"""Whether one structure is better than another, by a list of tests; a refusal is recorded with the test and its numbers."""

from __future__ import annotations

from dataclasses import dataclass

from diagnose.evidence.outcome import PASS, Outcome, Pair, Test, Veto, first_veto
from diagnose.evidence.rivals.encoder import no_error_of_the_encoder
from diagnose.evidence.rivals.events import no_moment_of_an_event
from diagnose.evidence.rivals.few_periods import no_slow_error
from diagnose.evidence.rivals.gain import gains
from diagnose.evidence.rivals.generalises import generalises, significant
from diagnose.evidence.rivals.law import no_error_of_a_law
from diagnose.evidence.rivals.quantisation import no_reading_of_the_encoder
from diagnose.evidence.rivals.servo import no_answer_of_a_servo
from diagnose.evidence.rivals.speed import no_function_of_the_speed
from diagnose.fit.fitted import Fitted
from diagnose.structure.graph import named
from diagnose.structure.state import Refusal, State

__all__ = ["Significance", "tests"]


def tests() -> tuple[Test, ...]:
    """The tests of a structure against a poorer one, in order."""
    return (
        gains, no_reading_of_the_encoder, no_error_of_a_law, generalises, no_answer_of_a_servo, no_slow_error,
        no_error_of_the_encoder, no_function_of_the_speed, no_moment_of_an_event,
    )  # fmt: skip


@dataclass
class Significance:
    """Decides between structures of a search; refusals are recorded in its state."""

    state: State

    def significant(self, before: Fitted, after: Fitted, attempt: int = 1) -> bool:
        """Whether ``after`` is better by the criterion, materially, on held-out data, and than what may stand in for it.

        ``attempt``: how many structures the held-out data have been asked about in this move, this one included.
        """
        outcome = self.outcome(before, after, attempt)
        if isinstance(outcome, Veto):
            self.state.refusals[after.key] = Refusal(after.key, before.key, outcome)
        else:
            self.state.refusals.pop(after.key, None)
        return outcome is PASS

    def outcome(self, before: Fitted, after: Fitted, attempt: int = 1) -> Outcome:
        """The first veto against ``after``, or `PASS`."""
        context = self.state.context
        hypotheses = context.fitter.noise.hypotheses(attempt, context.candidates)
        return first_veto(context, Pair(before, after, hypotheses), tests())

    def hardly_exercised(self, f: Fitted, key: str) -> bool:
        """Whether an effect of a structure gains on stretches of the estimation recordings alone."""
        context = self.state.context
        poorer = self.state.fits.get(tuple(k for k in f.key if k != key))
        if poorer is None or significant(context, context.compared(poorer, f), 1):
            return False
        blocks = context.compared_in_blocks(poorer, f)
        return blocks is not None and significant(context, blocks, 1)

    def dominates(self, f: Fitted, current: Fitted) -> bool:
        """Whether a structure beats another directly, and what it alone has is significant by itself.

        Used where the error is the model's own: two gains over a poor structure, each by its own effective sample size, say
        little of their difference; and an effect that is not significant beside the rest must not replace one that is.
        """
        context = self.state.context
        common = self.state.fits.common(f, current)
        if context.share_between is None or common is None or common.key == f.key:
            return True
        directly = context.gain(current, f) if f.chi2 < current.chi2 else -context.gain(f, current)
        return directly > 0 and self.significant(common, f)

    def contradicted(self, f: Fitted, other: Fitted) -> bool:
        """Whether held-out data speak against a structure and for another of its size that fits the estimation data worse."""
        c = self.state.context.compared(f, other)
        return significant(self.state.context, c, 1)

    def better_law(self, simpler: Fitted, current: Fitted) -> bool:
        """Whether another law of an effect of the simpler structure beats it, and not on the estimation data alone."""
        context = self.state.context
        if named(simpler) != named(current) or context.gain(simpler, current) < context.prices.entry:
            return False
        return context.compared(simpler, current).relative_gain > 0.0
