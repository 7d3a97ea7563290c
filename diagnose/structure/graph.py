"""Neighbours of a structure in the graph of structures, derived from what effects declare.

`add`: an effect more. `refine`: an effect by one that refines it, or at another spatial order. `vary`: an effect by another law
of the same name (`form_of`). `drop`, `simplify`: an effect less, or a reduced form
of one. `split`: a compound effect by its parts, the first refined; `merge`: the reverse. `limits`: an effect by its limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit, Linearised, Status, orthonormal
from diagnose.problem.hypothesis import make
from diagnose.structure.candidates import Candidate, can_replace, conflicts, inherit, related, replaced
from diagnose.structure.score import QUARTERS, Screened, screen
from diagnose.thresholds import CLEAR, EQUIVALENT, LEADING, MATERIAL
from mjsim.effects import Effect, effect_class

__all__ = [
    "Neighbour",
    "additions",
    "confounders",
    "limits",
    "merged",
    "named",
    "other_orders",
    "refines",
    "replacements",
    "simplified",
    "split",
    "without",
]

Neighbour = tuple[tuple[Effect, ...], Screened]
"""The effects that stay, and the one that is tried beside them."""

Fits = Mapping[tuple[str, ...], Fitted]


def without(effects: Sequence[Effect], effect: Effect) -> tuple[Effect, ...]:
    """The effects but one."""
    return tuple(e for e in effects if e.key != effect.key)


def additions(offered: Sequence[Candidate], base: Fitted, *, laws: bool) -> list[Candidate]:
    """Candidates that may be added to a structure.

    Another law of an effect takes the place of one that the nominal axis has, if ``laws``.
    """
    return [
        c for c in offered
        if not conflicts(c, base.effects) and (not effect_class(c.id).form_of or (laws and replaced(base, c) is not None))
    ]  # fmt: skip


def replacements(offered: Sequence[Candidate], base: Fitted, effect: Effect, *, laws: bool) -> list[Candidate]:
    """Candidates that refine an effect of a structure in its place: other effects, or its other ``laws``."""
    others = without(base.effects, effect)
    return [
        c for c in offered
        if can_replace(c, effect) and c.id != effect.id and not conflicts(c, others)
        and bool(effect_class(c.id).form_of) == laws and related(c.id, effect)
    ]  # fmt: skip


def other_orders(fitter: Fitter, base: Fitted, effect: Effect, *, material: bool) -> list[Neighbour]:
    """A position-locked effect at the spatial orders that stand out of the present residual.

    A refinement entered with a phase that its mean level hid: where the residual is ``material`` it is tried at every order, its
    own too, in each quarter turn, with its level as it is and the rest as at the start.
    """
    if "cycles_per_rev" not in effect.values:
        return []
    others = without(base.effects, effect)
    scales = fitter.scales_for(type(effect), effect.place)
    cls, own = type(effect), effect.values["cycles_per_rev"]
    known = {v["cycles_per_rev"]: v for v in cls.starts(scales)}
    if cls.refines and material:
        some = next(iter(known.values()), dict(effect.values))
        level = {name: effect.values[name] for name in cls.amplitudes}
        values = [{**v, **level} for v in ({**some, "cycles_per_rev": n} for n in dict.fromkeys((*known, own)))]
    else:
        orders = [
            n for n in (*scales.orders[:LEADING], *scales.swung) if n in known and abs(n - own) * scales.travel > 2 * math.pi
        ]
        values = [{**effect.values, "cycles_per_rev": n} for n in orders]
    starts = tuple(effect.with_values({**v, "phase_rad": phase}) for v in values for phase in QUARTERS)
    return [(others, Screened(Candidate(effect.id, effect.place), starts[0], math.inf, starts))] if starts else []


def confounders(fitter: Fitter, best: Fitted, effect: Effect, offered: Sequence[Candidate]) -> list[Neighbour]:
    """Effects whose response can stand in for that of an effect of the best structure.

    Each candidate's response at the best linear parameters is projected on the effect's own, both orthogonal to what these
    parameters take up; those that leave little of it are confounders.
    """
    others = without(best.effects, effect)
    bare = fitter.hypothesis(others, best.linear, best.own)
    (r0,) = fitter.run([fitter.at_start(bare)])
    shared = [i for i, e in enumerate(best.hypothesis.entries) if e.owner != effect.key]
    if r0 is None or len(r0) != len(best.fit.residual):
        return []
    J = best.fit.J[:, shared]
    fit = Fit(bare.start, float(r0 @ r0), Linearised.known(r0, J), Status.BUDGET, 0, 0.0)
    q = orthonormal(J)
    response = best.fit.residual - r0
    explained = float(np.sum((response - q @ (q.T @ response)) ** 2))
    known = {e.key for e in best.effects}
    multimodal = type(effect).multistart > 1
    supposed = [
        c for c in offered
        if c.key not in known and not conflicts(c, others)
        and not effect_class(c.id).form_of and (effect_class(c.id).name(), c.place) != (effect.name(), effect.place)
        and (multimodal or effect_class(c.id).multistart == 1)
        and not (c.place == effect.place and effect.id in effect_class(c.id).refines)
    ]  # fmt: skip
    ranked = screen(fitter, Fitted(bare, fit, best.n), supposed)
    return [(others, s) for s in ranked if s.gain > explained - max(CLEAR * EQUIVALENT, MATERIAL * explained)]


def merged(offered: Sequence[Candidate], effects: tuple[Effect, ...]) -> list[tuple[Effect, ...]]:
    """Structures with a compound effect in the place of two effects that are its parts."""
    out = []
    for c in offered:
        for parts in combinations(effects, 2):
            whole = effect_class(c.id).whole(parts)
            rest = tuple(e for e in effects if e not in parts)
            if whole is not None and whole.key == c.key and not conflicts(c, rest):
                out.append((*rest, whole))
    return out


def split(fitter: Fitter, offered: Sequence[Candidate], base: Fitted) -> list[Neighbour]:
    """For each compound effect of a structure its parts in its place, the first of them by an effect that refines it.

    Each start of that effect is a neighbour of its own: beside all that the compound effect explained, their first costs differ
    by too little to rank them.
    """
    out, keys = [], {c.key for c in offered}
    for effect in base.effects:
        others = without(base.effects, effect)
        if not effect.parts():
            continue
        first, *rest = effect.parts()
        beside = (*others, *rest)
        if any(e.key not in keys or conflicts(Candidate(e.id, e.place), others) for e in rest):
            continue
        for c in offered:
            cls = effect_class(c.id)
            refined = c.place == first.place and c.id != effect.id and first.id in cls.refines and not cls.form_of
            if refined and not conflicts(c, beside):
                starts = tuple(
                    make(c.id, c.place, inherit(cls, v, first)) for v in cls.starts(fitter.scales_for(cls, c.place))
                )  # fmt: skip
                out += [(beside, Screened(c, start, math.inf, (start,))) for start in starts]
    return out


def limits(offered: Sequence[Candidate], f: Fitted) -> list[Neighbour]:
    """For each effect of a structure its limits at a bound of its parameters, in its place."""
    out = []
    for effect in f.effects:
        others = without(f.effects, effect)
        for limit in effect.limits():
            c = Candidate(limit.id, limit.place)
            if c in offered and not conflicts(c, others):
                out.append((others, Screened(c, limit, math.inf, (limit,))))
    return out


def simplified(fitter: Fitter, f: Fitted, effect: Effect) -> list[tuple[Effect, ...]]:
    """The effects of a structure with one of them replaced by each effect that it refines, at the parameters that they share."""
    rest, out = without(f.effects, effect), []
    present = {e.key for e in (*rest, *fitter.nominal.effects)}
    for name in type(effect).refines:
        cls = effect_class(name)
        if effect.place in cls.places and f"{name}@{effect.place}" not in present:
            starts = cls.starts(fitter.scales_for(cls, effect.place))
            if not starts:
                continue
            values = dict(starts[0])
            values.update({k: v for k, v in effect.values.items() if k in values})
            out.append((*rest, make(name, effect.place, values)))
    return out


def refines(f: Fitted, current: Fitted) -> bool:
    """Whether a structure has a refinement of an effect of the other one."""
    gone = [e for e in current.effects if e.key not in f.key]
    return any(old.id in type(e).refines and can_replace(Candidate(e.id, e.place), old) for e in f.effects for old in gone)


def named(f: Fitted) -> tuple[str, ...]:
    """The public names and places of the effects of a structure, whatever their laws."""
    return tuple(sorted(f"{e.name()}@{e.place}" for e in f.effects))
