"""The effects that were found, with their numbers, evidence and equivalents."""

from __future__ import annotations

import math
from functools import partial

from diagnose.explain.weight_friction import follows_weight, load_effects
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.result import Finding, NominalEffect
from diagnose.structure.graph import merged as compounds
from diagnose.structure.graph import simplified
from diagnose.structure.search import Search
from diagnose.thresholds import EQUIVALENT, NEARLY_ALL, SEGMENT
from diagnose.verdict.decide import equivalents, estimates, p_values
from diagnose.verdict.servo_zero import with_an_offset
from mjsim.effects import Effect, NotApplicableError, effect_class

__all__ = ["element_of", "findings", "merged", "nominal_effect"]


def merged(search: Search, best: Fitted) -> Fitted:
    """The best structure with one compound effect for two, where the data do not tell them apart."""
    for effects in compounds(search.state.candidates, best.effects):
        simpler = search.fitter.fit(search.fitter.hypothesis(effects, best.linear, best.own), iterations=10)
        if simpler.ok and search.context.ahead(best, simpler) <= EQUIVALENT:
            search.keep(simpler)
            return search.fits[simpler.key]
    return best


def findings(search: Search, best: Fitted) -> tuple[Finding, ...]:
    """The effects of the best structure, strongest first, each against the structure without it.

    Rivals that may do as much in its place are fitted first, so that its equivalents are told from converged fits.
    """
    out = []
    fewer = search.fitter.map([partial(search.pruning.without, best, effect) for effect in best.effects])
    for effect, poorer in zip(best.effects, fewer, strict=True):
        search.pruning.fit_confounders(best, effect)
        p_held, p_fit, gain = p_values(search, poorer, best)
        before, after = search.held_out(poorer), search.held_out(best)
        numbers = estimates(best, search.fitter, owner=effect.key)
        alike = equivalents(search, best, effect)
        same = (*_by_weight(search, best, effect), *with_an_offset(search.fitter, best, effect))
        out.append(
            Finding(
                effect=effect.name(),
                form="" if effect.id == effect.name() else effect.id,
                place=effect.place,
                element=element_of(search.fitter, effect),
                sentence=effect.describe(search.fitter.nominal.chain.motion),
                parameters=numbers,
                evidence={
                    "held_out_error_before": before.rms if before else math.nan,
                    "held_out_error_after": after.rms if after else math.nan,
                    "p_value": min(1.0, p_held * max(1, search.tested)),
                    "p_value_estimation": p_fit,
                    "delta_chi2": gain,
                    "hypotheses": float(search.tested),
                },
                equivalents=(*alike, *(n for n in dict.fromkeys(same) if n not in alike)),
                equivalent_errors={name: error for name, error in alike.items() if math.isfinite(error)},
            )
        )
    out.sort(key=lambda f: -f.evidence["delta_chi2"])
    return tuple(out)


def _by_weight(search: Search, best: Fitted, effect: Effect) -> tuple[str, ...]:
    """Friction by the load, where what was found follows the torque of a weight over the angle and it does as much."""
    fitter = search.fitter
    chain, r = fitter.nominal.chain, fitter.experiments[0].recording
    if chain.couplings or r.angle is None:
        return ()
    others = [e for e in (*best.carried, *best.effects) if e.key != effect.key]
    some = r.angle[:: max(1, len(r.angle) // SEGMENT)]
    alike = follows_weight(effect, others, chain, some, fitter.scales["motor"].velocity)
    if max(alike, 0.0) ** 2 <= NEARLY_ALL:
        return ()
    return tuple(name for name in load_effects(effect) if _does_as_much(search, best, effect, name))


def _does_as_much(search: Search, best: Fitted, effect: Effect, name: str) -> bool:
    """Whether friction by the load beside the mean level of a friction over the angle leaves as little as that friction."""
    fitter, cls = search.fitter, effect_class(name)
    load = cls(place=effect.place, **cls.starts(fitter.scales_for(cls, effect.place))[0])
    try:
        load.ports(fitter.nominal.chain)
    except NotApplicableError:
        return False
    for simpler in simplified(fitter, best, effect):
        f = fitter.fit(fitter.hypothesis((*simpler, load), best.linear, best.own), iterations=10)
        if f.ok and search.context.ahead(best, f) <= EQUIVALENT:
            search.keep(f)
            return True
    return False


def nominal_effect(fitter: Fitter, best: Fitted, effect: Effect) -> NominalEffect:
    """An effect of the nominal model, as it was given and as the best structure has it: what the recordings exercise of it."""
    found = estimates(best, fitter, owner=effect.key)
    said = len(best.fit.residual) - best.hypothesis.prior_terms[0]
    for e, column in zip(best.hypothesis.entries, best.fit.J[:said].T, strict=True):
        if e.owner == effect.key and not column.any():
            found.pop(e.name, None)
    return NominalEffect(effect.id, effect.place, element_of(fitter, effect), effect.values, found)


def element_of(fitter: Fitter, effect: Effect) -> str:
    """The MJCF element at which an effect acts."""
    chain = fitter.nominal.chain
    return chain.element(effect.place, coupling=effect.on_coupling(chain))
