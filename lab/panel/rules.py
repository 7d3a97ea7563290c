"""The heuristics of a diagnosis that can be switched off: each by the names it stands under and what is neutral there.

When a name moves, its row is changed; when the heuristic goes, its row goes. `driver.switched_off` refuses a name that is gone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from mjsim.errors import InputError

__all__ = ["RULES", "Rule", "patches_of", "rules_of"]

SIGNIFICANCE = "diagnose.structure.significance"
CONTEXT = "diagnose.evidence.context.Context"
GRAPH = "diagnose.structure.graph"


@dataclass(frozen=True)
class Rule:
    """One heuristic. ``what``: what it does; ``patches``: see `lab.panel.driver.switched_off`."""

    name: str
    what: str
    patches: tuple[Mapping[str, Any], ...]


def _returns(name: str, what: str, value: Any, *targets: str) -> Rule:
    """Off when its functions return a value."""
    return Rule(name, what, tuple({"target": t, "returns": value} for t in targets))


def _test(name: str, what: str, target: str) -> Rule:
    """Off when a test of evidence has nothing against any structure."""
    return Rule(name, what, ({"target": f"{SIGNIFICANCE}.{target}", "named": "diagnose.evidence.outcome.PASS"},))


_ALL = (
    # screening and races
    _returns("decimation", "neighbours are screened on a part of the samples", 1, "diagnose.structure.screening.most_decimation"),
    _returns("race_bound", "a fit leaves the halving when its sensitivities predict too little gain", True,
             "diagnose.structure.halving.Halving.may_gain"),
    # neighbours in the graph of structures
    _returns("model_variants", "other laws of an effect are tried in its place", [], "diagnose.structure.moves.Moves._laws"),
    _returns("other_orders", "a position-locked effect is tried at the orders that stand out now", [], f"{GRAPH}.other_orders"),
    _returns("confounders", "confounders of each finding are fitted before it is reported", [],
             "diagnose.structure.pruning.Pruning.fit_confounders"),
    # evidence
    _test("encoder_rival", "an encoder that errs over its turn is a rival of each effect", "no_error_of_the_encoder"),
    _test("servo_rival", "the answer of a servo is a rival where the noise is not known", "no_answer_of_a_servo"),
    _test("few_periods_rival", "an order of few periods must explain more", "no_slow_error"),
    _test("speed_rival", "a position-locked effect must gain beside a function of the speed", "no_function_of_the_speed"),
    _test("events_rival", "another order of events is a rival beside nonsmooth effects", "no_moment_of_an_event"),
    _returns("held_out_blocks", "stretches of the estimation recording judge where held-out data cannot", None,
             f"{CONTEXT}.compared_in_blocks"),
    _returns("law_margin", "a gain must exceed the error of a law", 0.0, f"{CONTEXT}.law_error"),
)  # fmt: skip

RULES: dict[str, Rule] = {rule.name: rule for rule in _ALL}


def patches_of(rules: Iterable[Rule]) -> dict[str, tuple[Mapping[str, Any], ...]]:
    """What each rule, by its name, is counted by."""
    return {rule.name: rule.patches for rule in rules}


def rules_of(names: tuple[str, ...]) -> list[Rule]:
    """Rules by name. Raises InputError that lists the choices."""
    for name in names:
        if name not in RULES:
            raise InputError(f"rule {name!r}", "not known", f"one of {', '.join(RULES)}")
    return [RULES[name] for name in names]
