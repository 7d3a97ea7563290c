"""Which effects can be added to an axis: every registered effect at every place that the chain has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.problem.hypothesis import make
from mjsim.effects import Effect, NotApplicableError, effect_class, registered

__all__ = ["Candidate", "can_replace", "candidates", "conflicts", "inherit", "related", "replaced"]


@dataclass(frozen=True)
class Candidate:
    """An effect at a place, not yet with numbers."""

    id: str
    place: str

    @property
    def key(self) -> str:
        """``id@place``."""
        return f"{self.id}@{self.place}"


def candidates(fitter: Fitter, only: Sequence[str] = ()) -> tuple[Candidate, ...]:
    """All effects and places that this axis has; ``only`` restricts the identifiers (an unknown one raises KeyError).

    Effects of the nominal axis are fitted with its parameters. A refinement of one is a candidate that takes its place; an effect
    that repeats one, or is a reduced form of it, is none.
    """
    for name in only:
        effect_class(name)
    out = []
    for name, cls in registered().items():
        if only and cls.name() not in only and name not in only:
            continue
        if cls.rigid and fitter.nominal.chain.couplings:
            continue
        for place in cls.places:
            if place == "actuator" and not fitter.nominal.chain.driven:
                continue
            starts = cls.starts(fitter.scales_for(cls, place))
            if not starts:
                continue
            try:
                make(name, place, starts[0]).ports(fitter.nominal.chain)
            except NotApplicableError:
                continue
            candidate = Candidate(name, place)
            if not conflicts(candidate, [e for e in fitter.nominal.effects if e.place != place or e.id not in cls.refines]):
                out.append(candidate)
    return tuple(out)


def conflicts(candidate: Candidate, present: Sequence[Effect]) -> bool:
    """Whether a candidate repeats a present effect: the same one, or one that refines or is refined by it."""
    cls = effect_class(candidate.id)
    for e in present:
        if e.key == candidate.key or (cls.once and e.id == candidate.id):
            return True
        if e.place != candidate.place:
            continue
        if e.id in cls.refines or candidate.id in type(e).refines or (set(cls.refines) & set(type(e).refines)):
            return True
    return False


def can_replace(c: Candidate, effect: Effect) -> bool:
    """Whether a candidate stands where an effect does: at its place, or, refining it, at one that the effect cannot have.

    A weight hangs on the arm; what it comes to over little travel is an offset of the motor's torque.
    """
    cls = effect_class(c.id)
    return c.place == effect.place or (effect.id in cls.refines and effect.place not in cls.places)


def replaced(base: Fitted, c: Candidate) -> Effect | None:
    """The effect of the nominal axis, as fitted, whose place a candidate takes."""
    refined = effect_class(c.id).refines
    return next((e for e in base.carried if e.place == c.place and e.id in refined), None)


def inherit(cls: type[Effect], values: Mapping[str, float], effect: Effect, ratio: float | None = None) -> dict[str, float]:
    """Start values of a refinement: its level, and what else it shares, from the effect that it refines.

    ``ratio``: of torques where it stands to those where that effect does, None at the same place; from another place the level
    comes without its sign.
    """
    merged = dict(values)
    level = effect.values.get("torque_Nm")
    if level is not None and merged.get("torque_Nm"):
        level = level if ratio is None else abs(level * ratio)
        factor = level / merged["torque_Nm"]
        for name in cls.amplitudes:
            merged[name] *= factor
        merged["torque_Nm"] = level
    for name, value in effect.values.items():
        if name in merged and name != "torque_Nm":
            merged[name] = value
    return merged


def related(name: str, effect: Effect) -> bool:
    """Whether an effect refines another, or both refine the same.

    Another form of an effect refines it, or other refinements, or takes the place of those that refine that effect.
    """
    cls = effect_class(name)
    if cls.form_of:
        refined = effect.id in cls.refines and (effect.id == cls.form_of or bool(type(effect).refines))
        return refined or cls.form_of in type(effect).refines
    return effect.id in cls.refines or name in type(effect).refines or bool(set(cls.refines) & set(type(effect).refines))
