"""Whether one structure is better than another: a list of tests, and fits that make the comparison fair.

The tests judge and change nothing. What is fitted for a comparison is fitted here, goes into the pool, and is judged again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from diagnose.evidence.outcome import PASS, Outcome, Pair, Test, Veto, first_veto
from diagnose.evidence.rivals.encoder import no_error_of_the_encoder
from diagnose.evidence.rivals.events import no_moment_of_an_event
from diagnose.evidence.rivals.few_periods import no_slow_error
from diagnose.evidence.rivals.gain import gains
from diagnose.evidence.rivals.generalises import generalises, significant
from diagnose.evidence.rivals.law import no_error_of_a_law
from diagnose.evidence.rivals.servo import no_answer_of_a_servo
from diagnose.fit.fitted import Fitted
from diagnose.fit.starts import warm_started
from diagnose.structure.continuation import Continuation
from diagnose.structure.moves import named
from diagnose.structure.state import Refusal, State
from diagnose.thresholds import CLEAR_GAIN, MOVED, RESTARTED_BELOW

__all__ = ["Significance", "before_held_out", "rivals"]


def before_held_out() -> tuple[Test, ...]:
    """Tests ahead of the held-out data, in order."""
    return gains, no_error_of_a_law


def rivals() -> tuple[Test, ...]:
    """Tests against what may stand in for an effect, in order."""
    return no_answer_of_a_servo, no_slow_error, no_error_of_the_encoder, no_moment_of_an_event


@dataclass
class Significance:
    """Decides between structures of a search; refusals are written down in its state."""

    state: State
    path: Continuation
    _richer: dict[tuple[object, ...], Fitted | None] = field(default_factory=dict, init=False)
    _poorer: dict[tuple[object, ...], Fitted] = field(default_factory=dict, init=False)

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
        """The first veto against ``after``, or `PASS`.

        A richer structure that the held-out data refuse is judged again from the poorer one's numbers, and one that passes is
        judged against the poorer one from its numbers: two fits may compare two guesses of a parameter and not the structures.
        """
        context = self.state.context
        asked = context.fitter.noise.hypotheses(attempt, context.candidates)
        outcome = first_veto(context, Pair(before, after, asked), before_held_out())
        if isinstance(outcome, Veto):
            return outcome
        outcome = generalises(context, Pair(before, after, asked))
        if isinstance(outcome, Veto):
            again = self.richer_from(before, after)
            if again is None or not self.generalises_by(before, again, 2 * asked):
                return outcome
            after = again
        outcome = first_veto(context, Pair(before, after, asked), rivals())
        if isinstance(outcome, Veto):
            return outcome
        lower = self.poorer_from(before, after)
        return PASS if lower is before else self.outcome(lower, after, attempt)

    def richer_from(self, before: Fitted, after: Fitted) -> Fitted | None:
        """A richer structure fitted from the numbers that a poorer one has come to since, once; None where that is worse.

        Held-out data may ask more of a number than the others tell of it. Of two fits that the estimation data do not tell apart
        the one that shares the poorer's numbers is compared.
        """
        state, fitter = self.state, self.state.fitter
        much = math.log(before.chi2 / after.chi2) > CLEAR_GAIN * state.options.material
        if not fitter.noise.absolute or after.rough or not set(before.key) < set(after.key) or not much:
            return None
        if state.context.compared(before, after).relative_gain > -state.options.material:
            return None  # that is no error of a number
        asked = (before.key, before.chi2, after.key, after.chi2)
        if asked not in self._richer:
            new = [e for e in after.effects if e.key not in before.key]
            begun = fitter.fit(fitter.hypothesis((*before.effects, *new), before.linear, before.own), iterations=12)
            alike = begun.ok and begun.chi2 < after.chi2 + state.options.entry
            by_place = [dict(zip((e.label for e in f.hypothesis.entries), f.fit.x, strict=True)) for f in (begun, after)]
            moved = max(abs(x - by_place[1][label]) for label, x in by_place[0].items())
            self._richer[asked] = begun if alike and moved > MOVED else None
        return self._richer[asked]

    def generalises_by(self, before: Fitted, again: Fitted, hypotheses: int) -> bool:
        """Whether a richer structure gains on held-out data by another fit of it, which then stands for it."""
        beside = self.state.context.beside(again)
        if generalises(beside, Pair(before, again, hypotheses)) is not PASS:
            return False
        self.state.pool.adopt(again, beside.pool)
        return True

    def poorer_from(self, before: Fitted, after: Fitted) -> Fitted:
        """A nonsmooth structure fitted from the numbers of a richer one; itself where that is no better.

        Of its minima it may have missed the one to which the richer one has come by another way. One that leaves little more than
        noise is landed as well: a minute gain may be that of an event a sample sooner.
        """
        state, fitter = self.state, self.state.fitter
        if not before.rough or not fitter.noise.absolute or not set(before.key) < set(after.key):
            return before
        asked = (before.key, before.chi2, after.key, after.chi2)
        if asked not in self._poorer:
            if before.chi2 < RESTARTED_BELOW * before.n:
                self.path.land(before)
            begun = [] if warm_mark(before.key, after) in state.warm else [warm_started(fitter, after, before.key, 20)]
            landed = min(before, state.pool.newest(before), key=lambda f: f.chi2)
            self._poorer[asked] = min((self.path.restart(f) for f in (*begun, landed) if f.ok), key=lambda f: f.chi2)
        lower = self._poorer[asked]
        state.keep(lower)
        return lower if lower.chi2 < before.chi2 - 1.0 else before

    def hardly_exercised(self, f: Fitted, key: str) -> bool:
        """Whether an effect of a structure gains on stretches of the estimation recordings alone."""
        context = self.state.context
        poorer = self.state.pool.get(tuple(k for k in f.key if k != key))
        if poorer is None or significant(context, context.compared(poorer, f), 1):
            return False
        blocks = context.compared_in_blocks(poorer, f)
        return blocks is not None and significant(context, blocks, 1)

    def dominates(self, f: Fitted, current: Fitted) -> bool:
        """Whether a structure beats another directly, and what it alone has is significant by itself.

        Asked where the error is the model's own: two gains counted from far off, each by its own samples' worth, say little of
        their difference; and an effect that is not significant beside the rest must not enter in exchange for one that is.
        """
        context = self.state.context
        common = self.state.pool.common(f, current)
        if context.worth_of is None or common is None or common.key == f.key:
            return True
        directly = context.gain(current, f) if f.chi2 < current.chi2 else -context.gain(f, current)
        return directly > 0 and self.significant(common, f)

    def contradicted(self, f: Fitted, other: Fitted) -> bool:
        """Whether held-out data speak against a structure and for another of its size that fits the estimation data worse."""
        c = self.state.context.compared(f, other)
        return significant(self.state.context, c, 1)

    def better_law(self, simpler: Fitted, current: Fitted) -> bool:
        """Whether another law of what the simpler structure names as well beats it, and not on the estimation data alone."""
        context = self.state.context
        if named(simpler) != named(current) or context.gain(simpler, current) < context.prices.entry:
            return False
        return context.compared(simpler, current).relative_gain > 0.0


def warm_mark(key: tuple[str, ...], richer: Fitted) -> tuple[object, ...]:
    """That a structure was fitted from the numbers of a richer one."""
    return key, richer.key, round(math.log(richer.chi2), 2)
