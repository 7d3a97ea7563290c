"""The heuristics of a diagnosis that can be switched off: each by the names it stands under and what is neutral there.

When a name moves, its row is changed; when the heuristic goes, its row goes. `driver.switched_off` refuses a name that is gone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mjsim.errors import InputError

__all__ = ["RULES", "Rule", "rules_of"]

SEARCH = "diagnose.structure.search"
SIGNIFICANCE = "diagnose.structure.significance"
CONTEXT = "diagnose.evidence.context.Context"
PATH = "diagnose.structure.continuation.Continuation"
STARTS = "diagnose.structure.multistart.Multistart"
RACE = "diagnose.structure.race.Race"
GROWTH = "diagnose.structure.growth"
SCREEN = "diagnose.structure.screening"


@dataclass(frozen=True)
class Rule:
    """One heuristic. ``what``: what it does; ``patches``: see `lab.panel.driver.switched_off`."""

    name: str
    what: str
    patches: tuple[Mapping[str, Any], ...]


def _returns(name: str, what: str, value: Any, *targets: str) -> Rule:
    """Off when its functions return a value."""
    return Rule(name, what, tuple({"target": t, "returns": value} for t in targets))


def _passes(name: str, what: str, argument: int | list[int], *targets: str) -> Rule:
    """Off when its functions return an argument, or some, as they were given; that of a method counts ``self`` as 0."""
    return Rule(name, what, tuple({"target": t, "argument": argument} for t in targets))


def _value(name: str, what: str, value: Any, target: str) -> Rule:
    """Off when a constant has a value."""
    return Rule(name, what, ({"target": target, "value": value},))


_ALL = (
    # starts and restarts
    _passes("nominal_restarts", "restarts of the nominal structure where it leaves much", 1, f"{STARTS}._about_nominal"),
    _returns("restart_new_bodies", "new bodies are fitted from the nominal parameters too", None, f"{STARTS}.from_nominal"),
    _returns("restart_short", "the best of the screen is restarted when it gains less than the score test says", None,
             f"{STARTS}.short_of_promise"),
    _returns("restart_limits", "a law at the edge of its numbers is fitted as its limit", [], f"{STARTS}.limits"),
    _passes("restart_covariance", "nonsmooth structures are restarted from points of the covariance", 1, f"{PATH}.restart"),
    _passes("wide_secants", "the winner of a race is fitted by wide secants where its cost is rough", 1, f"{PATH}.smoothed"),
    # continuation
    _returns("observer_search", "a search among models with a high observer gain", None, "diagnose.structure.passes.among_led"),
    _passes("observer_first", "nonsmooth structures are compared under observer gain before a round goes on", 2,
            f"{SEARCH}.Search._under_observer"),
    _returns("landing_rivals", "rivals near the best are fitted by decreasing observer gain", None, f"{PATH}.land_near"),
    _returns("landing", "nonsmooth structures are fitted by decreasing observer gain", None, f"{PATH}.land"),
    _returns("gain_homotopy", "homotopy in the observer gain to the free run, in small steps", None, "diagnose.fit.path.released",
             "diagnose.structure.observer_search.released"),
    _passes("growing_horizon", "multimodal structures are fitted over growing horizons", 1, "diagnose.fit.path.over_horizons",
            "diagnose.fit.validation.over_horizons"),
    _returns("continuation", "growing horizons and the homotopy, both", None, f"{PATH}.grow"),
    _passes("tempered_prior", "a prior of the nominal parameters while much is left", 1,
            "diagnose.structure.tempering.Tempering.tempered"),
    # screening and races
    _value("decimation", "rivals are screened on a part of the samples", 10**9, f"{SCREEN}.LEAST_SAMPLES"),
    _returns("screen_from_nominal", "rivals are screened beside the nominal parameters too", [], f"{SCREEN}.Look.from_nominal"),
    _returns("own_sensitivities", "fits begun at the nominal parameters go on by their own sensitivities", [],
             f"{SCREEN}.Look._on_from_nominal"),
    _returns("race_forecast", "a rival leaves a race when its sensitivities promise too little", True,
             f"{RACE}.promising"),
    _passes("race_cost", "rivals too slow for the budget are not raced", 2, f"{RACE}._within_reach"),
    _returns("strong_first", "what promises nearly all is tried before refinements", False, f"{GROWTH}.Growth.promises"),
    _returns("stagnation", "the search ends after effects that explain little of much", False, f"{SEARCH}.Search._creeps"),
    # neighbours in the graph of structures
    _returns("exchange", "an effect gives way to a confounder beside a simpler structure", [], f"{GROWTH}.Growth.exchange"),
    _returns("exchange_alike", "the same for effects of equal motion, ahead of refinements", [],
             f"{GROWTH}.Growth.exchange_confounders"),
    _returns("larger_pairs", "structures one effect larger that gain much are built on though they do not pay", [],
             f"{SEARCH}.Search._larger"),
    _passes("simplest_form", "effects are added beside the simplest form of a structure", 0, f"{SEARCH}.ground",
            f"{GROWTH}.ground", "diagnose.structure.observer_search.ground"),
    _returns("model_variants", "model variants of an effect are tried in its place", [], f"{GROWTH}.Growth._other_laws"),
    _passes("variants_of_rivals", "rivals near the best are tried by model variants", 1, f"{SEARCH}.Search._against_other_laws"),
    _returns("other_orders", "a position-locked effect is tried at the orders that stand out now", [], f"{GROWTH}.other_orders"),
    _returns("taken_apart", "a compound effect is split and its first part refined", [], f"{GROWTH}.taken_apart"),
    _returns("confounders", "confounders of each finding are fitted before it is reported", None,
             "diagnose.structure.reduction.Reduction.fit_confounders"),
    # evidence
    _returns("encoder_rival", "an encoder that errs over its turn is a rival of each effect", None,
             f"{SIGNIFICANCE}.no_error_of_the_encoder"),
    _returns("servo_rival", "the answer of a servo is a rival where the noise is not known", None,
             f"{SIGNIFICANCE}.no_answer_of_a_servo"),
    _returns("few_periods_rival", "an order of few periods must explain more", None, f"{SIGNIFICANCE}.no_slow_error"),
    _returns("events_rival", "another order of events is a rival beside nonsmooth effects", None,
             f"{SIGNIFICANCE}.no_moment_of_an_event"),
    _passes("restart_poorer", "the poorer structure is restarted from the richer one", 1,
            f"{SIGNIFICANCE}.Significance.poorer_from"),
    _returns("held_out_blocks", "stretches of the estimation recording judge where held-out data cannot", None,
             f"{CONTEXT}.compared_in_blocks"),
    _returns("law_margin", "a gain must exceed the error of a law", 0.0, f"{CONTEXT}.law_error"),
    _passes("second_filter", "the search is repeated by the filter of a refused structure", [3, 4],
            "diagnose.structure.passes._less_coloured"),
)  # fmt: skip

RULES: dict[str, Rule] = {rule.name: rule for rule in _ALL}


def rules_of(names: tuple[str, ...]) -> list[Rule]:
    """Rules by name. Raises InputError that lists the choices."""
    for name in names:
        if name not in RULES:
            raise InputError(f"rule {name!r}", "not known", f"one of {', '.join(RULES)}")
    return [RULES[name] for name in names]
