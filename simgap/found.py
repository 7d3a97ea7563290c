"""What a diagnosis found, as effects and as an axis."""

from __future__ import annotations

from diagnose.result import Diagnosis, Finding
from mjsim.axis import Axis
from mjsim.effects import Effect, effect_class

__all__ = ["as_fitted", "corrected_axis", "effect_found", "physics_found"]


def effect_found(f: Finding) -> Effect:
    """The effect of a finding, at its numbers."""
    return effect_class(f.law)(place=f.place, **{k: v.value for k, v in f.parameters.items()})


def physics_found(diagnosis: Diagnosis) -> list[Effect]:
    """The effects that were found, but for settings of the simulator."""
    return [effect_found(f) for f in diagnosis.findings if f.kind == "physics"]


def as_fitted(diagnosis: Diagnosis) -> dict[str, float]:
    """The fitted numbers of the nominal model: linear parameters by name, those of its effects as ``id@place.name``."""
    values = {k: v.value for k, v in diagnosis.linear_parameters.items()}
    for own in diagnosis.nominal_effects:
        values |= own.values
    return values


def corrected_axis(nominal: Axis, diagnosis: Diagnosis) -> Axis:
    """The nominal axis with its numbers as fitted and the findings; one that refines an effect of it takes its place."""
    return nominal.with_values(as_fitted(diagnosis)).with_effects(physics_found(diagnosis))
