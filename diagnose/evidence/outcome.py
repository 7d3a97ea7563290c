"""What a test of one structure against another says: nothing against it, or a veto with its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

from diagnose.evidence.context import Context
from diagnose.fit.fitted import Fitted

__all__ = ["PASS", "Outcome", "Pair", "Pass", "Test", "Veto", "first_veto"]


@final
@dataclass(frozen=True)
class Pass:
    """The test has nothing against the richer structure."""


@final
@dataclass(frozen=True)
class Veto:
    """The test refuses the richer structure.

    code: which test; numbers: what it measured and what it asks for.
    """

    code: str
    numbers: Mapping[str, float]


Outcome = Pass | Veto
PASS = Pass()


@final
@dataclass(frozen=True)
class Pair:
    """A structure ``after`` to be judged against another ``before``.

    hypotheses: how many structures the held-out data were asked about, for which p-values are corrected.
    """

    before: Fitted
    after: Fitted
    hypotheses: int = 1

    @property
    def nested(self) -> bool:
        """Whether ``after`` has all effects of ``before``, and more."""
        return set(self.before.key) < set(self.after.key)


Test = Callable[[Context, Pair], Outcome]


def first_veto(context: Context, pair: Pair, tests: Sequence[Test]) -> Outcome:
    """The veto of the first test that refuses; the tests that follow are not run."""
    for test in tests:
        outcome = test(context, pair)
        if isinstance(outcome, Veto):
            return outcome
    return PASS
