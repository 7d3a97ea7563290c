"""Moves from one structure to another: which effects may take the place of one that stands in it, and from which numbers."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import combinations

import numpy as np

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit, Linearised, Status, orthonormal
from diagnose.problem.hypothesis import make
from diagnose.structure.candidates import QUARTERS, Candidate, Screened, conflicts, inherit, screen, takes_place
from diagnose.thresholds import LIKELY, NEARLY, ONE_MOTION, SECANT_ERROR, SLACK
from mjsim.effects import Effect, effect_class

__all__ = [
    "Entrant",
    "at_limits",
    "elsewhere",
    "folded",
    "formed",
    "ground",
    "imitators",
    "in_place",
    "named",
    "other_orders",
    "promising",
    "put_together",
    "refines",
    "simpler_at",
    "taken_apart",
    "with_other_laws",
]

Entrant = tuple[tuple[Effect, ...], Screened]
"""The effects that stay, and the one that is tried beside them."""


def ground(f: Fitted, pool: Mapping[tuple[str, ...], Fitted]) -> Fitted:
    """A structure with its effects in the simplest forms that explain nearly as much.

    While another effect is missing, refinements stand in for it: what goes beside them is sought from their simpler form, at
    fewer parameters, and they are tried again once it is there (`Growth.refine`).
    """
    if f.chi2 < 1.5 * f.n:
        return f
    for effect in f.effects:
        rest = [k for k in f.key if k != effect.key]
        for name in type(effect).refines:
            simple = pool.get(tuple(sorted([*rest, f"{name}@{effect.place}"])))
            if simple is not None and simple.chi2 < NEARLY * f.chi2:
                return ground(simple, pool)
    return f


def at_limits(f: Fitted) -> list[tuple[Effect, ...]]:
    """The effects of a structure with one of them as what it comes to at an edge of its numbers, at those numbers."""
    pairs = [(tuple(e for e in f.effects if e.key != effect.key), limit) for effect in f.effects for limit in effect.limits()]
    return [(*others, limit) for others, limit in pairs if not conflicts(Candidate(limit.id, limit.place), others)]


def simpler_at(f: Fitted) -> list[tuple[Effect, ...]]:
    """The effects of a structure with one of them as a law that it refines, at those of its numbers that are that law's."""
    out = []
    for effect in f.effects:
        others = tuple(e for e in f.effects if e.key != effect.key)
        for name in type(effect).refines:
            cls = effect_class(name)
            names = [spec.name for spec in cls.specs()]
            own = [effect.values[k] for k in names if k in effect.values]
            if len(own) == len(names) and effect.place in cls.places and not conflicts(Candidate(name, effect.place), others):
                out.append((*others, make(name, effect.place, dict(zip(names, own, strict=True)))))
    return out


def taken_apart(fitter: Fitter, offered: Sequence[Candidate], effect: Effect, others: tuple[Effect, ...]) -> list[Entrant]:
    """A compound effect taken apart, and its first part refined: Stribeck friction and an offset for asymmetric friction."""
    if not effect.parts():
        return []
    first, *rest = effect.parts()
    beside = (*others, *rest)
    keys = {c.key for c in offered}
    if any(e.key not in keys or conflicts(Candidate(e.id, e.place), others) for e in rest):
        return []
    out = []
    for c in offered:
        cls = effect_class(c.id)
        if c.place != first.place or c.id == effect.id or first.id not in cls.refines or cls.form_of or conflicts(c, beside):
            continue
        values = cls.starts(fitter.scales_for(cls, c.place))
        starts = tuple(make(c.id, c.place, inherit(cls, v, first)) for v in values)
        out.append((beside, Screened(c, starts[0], math.inf, starts)))
    return out


def put_together(offered: Sequence[Candidate], effects: tuple[Effect, ...]) -> list[tuple[Effect, ...]]:
    """Structures with one effect fewer that make the same motion: a compound effect for its parts."""
    out = []
    for c in offered:
        for parts in combinations(effects, 2):
            whole = effect_class(c.id).whole(parts)
            rest = tuple(e for e in effects if e not in parts)
            if whole is not None and whole.key == c.key and not conflicts(c, rest):
                out.append((*rest, whole))
    return out


def other_orders(fitter: Fitter, effect: Effect, others: tuple[Effect, ...], *, material: bool) -> list[Entrant]:
    """A position-locked effect once more at the orders that now stand out: it may have entered at a wrong one.

    One that refines a simpler effect entered with a phase that its mean level drowned: where it leaves something ``material`` it
    is tried at every order, its own too, in each quarter turn, with its level as it is and the rest as at the start.
    """
    if "cycles_per_rev" not in effect.values:
        return []
    scales = fitter.scales_for(type(effect), effect.place)
    cls, own = type(effect), effect.values["cycles_per_rev"]
    known = {v["cycles_per_rev"]: v for v in cls.starts(scales)}
    if cls.refines and material:
        some = next(iter(known.values()), dict(effect.values))
        level = {name: effect.values[name] for name in cls.amplitudes}
        values = [{**v, **level} for v in ({**some, "cycles_per_rev": n} for n in dict.fromkeys((*known, own)))]
    else:
        orders = [n for n in (*scales.orders[:LIKELY], *scales.swung) if n in known and abs(n - own) > 0.02 * n]
        values = [{**effect.values, "cycles_per_rev": n} for n in orders]
    starts = tuple(effect.with_values({**v, "phase_rad": phase}) for v in values for phase in QUARTERS)
    return [(others, Screened(Candidate(effect.id, effect.place), starts[0], math.inf, starts))] if starts else []


def in_place(pool: Mapping[tuple[str, ...], Fitted], offered: Sequence[Candidate], base: Fitted, within: float) -> list[Entrant]:
    """For each effect of a structure: those that did as much in its place beside a simpler one, with the numbers they had there.

    ``within``: largest difference of the logarithms of chi-square. Two delays are told apart by nothing while friction is
    missing; which of them stands in a structure is an accident until it is there.
    """
    keys, out = {c.key for c in offered}, []
    for effect in base.effects:
        others = tuple(e for e in base.effects if e.key != effect.key)
        seen: set[str] = set()
        for f in sorted((f for f in pool.values() if effect.key not in f.key), key=lambda f: f.chi2):
            for rival in (e for e in f.effects if e.key not in base.key and e.key in keys and e.key not in seen):
                if rival.place == effect.place and rival.id in type(effect).refines:
                    continue  # a simpler form
                beside = pool.get(tuple(sorted([effect.key, *(k for k in f.key if k != rival.key)])))
                c = Candidate(rival.id, rival.place)
                if beside is not None and abs(math.log(f.chi2 / beside.chi2)) < within and not conflicts(c, others):
                    seen.add(rival.key)
                    out.append((others, Screened(c, rival, math.inf, (rival,))))
    return out


def imitators(fitter: Fitter, best: Fitted, effect: Effect, offered: Sequence[Candidate]) -> list[Entrant]:
    """What may do as much as an effect of the best structure in its place, by its response there: to be fitted before it is told.

    A rival that entered far from here may have been dropped before it came to its best. Each candidate's response at the best
    linear parameters is projected on the effect's own, what these parameters take up apart; those that leave little of it are
    the ones to fit.
    """
    others = tuple(e for e in best.effects if e.key != effect.key)
    bare = fitter.hypothesis(others, best.linear, best.own)
    (without,) = fitter.run([fitter.at_start(bare)])
    shared = [i for i, e in enumerate(best.hypothesis.entries) if e.owner != effect.key]
    if without is None or len(without) != len(best.fit.residual):
        return []
    J = best.fit.J[:, shared]
    fit = Fit(bare.start, float(without @ without), Linearised.known(without, J), Status.BUDGET, 0, 0.0)
    q = orthonormal(J)
    response = best.fit.residual - without
    explained = float(np.sum((response - q @ (q.T @ response)) ** 2))
    known = {e.key for e in best.effects}
    folds = type(effect).multistart > 1
    supposed = [
        c for c in offered
        if c.key not in known and not conflicts(c, others)
        and not effect_class(c.id).form_of and (effect_class(c.id).name(), c.place) != (effect.name(), effect.place)
        and (folds or effect_class(c.id).multistart == 1)  # those take many starts, and are like each other
        and not (c.place == effect.place and effect.id in effect_class(c.id).refines)
    ]  # fmt: skip
    ranked = screen(fitter, Fitted(bare, fit, best.n), supposed)
    return [(others, s) for s in ranked if s.gain > explained - max(SECANT_ERROR, SLACK * explained)]


def folded(f: Fitted) -> bool:
    """Whether the error of a structure has several minima."""
    return any(type(e).multistart > 1 or type(e).rough for e in f.effects)


def formed(f: Fitted) -> bool:
    """Whether a structure holds another law of an effect that the contract names: its rival in numbers, not in kind."""
    return any(type(e).form_of for e in f.effects)


def refines(f: Fitted, current: Fitted) -> bool:
    """Whether a structure says more by a refinement of an effect that stands in the other one."""
    gone = [e for e in current.effects if e.key not in f.key]
    return any(old.id in type(e).refines and takes_place(Candidate(e.id, e.place), old) for e in f.effects for old in gone)


def elsewhere(f: Fitted, current: Fitted) -> bool:
    """Whether a structure is the same effects at other places, to the same error: so is what is added to it."""
    same = sorted(e.id for e in f.effects) == sorted(e.id for e in current.effects)
    return same and f.key != current.key and abs(math.log(f.chi2 / current.chi2)) < ONE_MOTION


def named(f: Fitted) -> tuple[str, ...]:
    """What a structure is called: the contract's names of its effects and their places, whatever their laws."""
    return tuple(sorted(f"{e.name()}@{e.place}" for e in f.effects))


def promising(
    pool: Mapping[tuple[str, ...], Fitted], current: Fitted, without: Collection[tuple[str, ...]], least: float = 0.7
) -> list[Fitted]:
    """Structures one effect larger, not those ``without``, that gain much on the estimation data: chi-square falls to ``least``.

    Held-out data need not bear them out. Where two effects are missing, each may spoil what the other gains elsewhere: together
    they have to pay, not each first.
    """
    larger = [f for f in pool.values() if len(f.effects) == len(current.effects) + 1 and f.key not in without]
    return [f for f in larger if f.chi2 < least * current.chi2]


def with_other_laws(
    pool: Mapping[tuple[str, ...], Fitted], offered: Sequence[Candidate], current: Fitted, within: float
) -> list[Fitted]:
    """Structures as large as the current one and nearly as good, by ``within`` in the logarithm of chi-square, best first, that
    hold an effect of which another law is offered; not those that only refine the current one, and fit as it does."""
    known = {effect_class(c.id).form_of for c in offered} - {""}
    alike = [f for f in pool.values() if len(f.effects) == len(current.effects) and f.key != current.key]
    near = [f for f in alike if math.log(f.chi2 / current.chi2) < within and any(e.id in known for e in f.effects)]
    near = [f for f in near if not refines(f, current)]
    return sorted(near, key=lambda f: f.chi2)
