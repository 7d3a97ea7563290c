"""Decisions after the search: intervals, p-values, equivalents and the verdict."""

from __future__ import annotations

import math

import numpy as np

from diagnose.evidence.intervals import at_bounds, half_width
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.options import Options
from diagnose.problem.start_state import is_of_start
from diagnose.result import Diagnosis, Estimate, Verdict
from diagnose.structure.search import Search
from diagnose.thresholds import EQUIVALENT, LARGE, ROUNDING, UNEXPLAINED
from diagnose.verdict.witnesses import Remaining, RepeatedRows
from mjsim.effects import Effect

__all__ = ["decide", "equivalents", "estimates", "only_held_out_shows", "only_repeated_rows", "p_values"]


def decide(search: Search, base: Fitted, best: Fitted, remaining: Remaining) -> Verdict:
    """Unexplained when a material part of the held-out residual is left, or a parameter at its bound; else by what was found.

    Without effects the refitted parameters must gain more than their price, by the criterion, to count as changed; and where the
    noise is not known, predict the held-out recordings better.
    """
    if remaining.unexplained or (not best.effects and at_bounds(best)):
        return Verdict.UNEXPLAINED
    if best.effects:
        return Verdict.MISSING_PHYSICS
    fitter = search.fitter
    starts = {k: v for k, v in base.own.items() if is_of_start(k[0], k[1])}
    as_given = fitter.hypothesis((), None, starts).start
    as_is = fitter.residual(base.hypothesis)(as_given)
    if as_is is None:
        return Verdict.PARAMETERS_ONLY
    if not fitter.noise.absolute and not _predicts_better(search, base, as_given):
        return Verdict.NO_MISMATCH
    count = base.hypothesis.size
    given = float(as_is @ as_is)
    if not given > base.chi2:  # also where nothing is left of either
        return Verdict.NO_MISMATCH
    gain = search.context.effective * base.n * math.log(given / base.chi2) if base.chi2 > 0 else math.inf
    return Verdict.PARAMETERS_ONLY if gain > search.options.entry + search.options.price * count / 2 else Verdict.NO_MISMATCH


def only_held_out_shows(result: Diagnosis) -> bool:
    """Whether the mismatch is unexplained, and is none on the recordings that were fitted."""
    best = result.fit["corrected"]
    clean = best.rms**2 < UNEXPLAINED * result.noise_floor**2
    return result.verdict is Verdict.UNEXPLAINED and clean and best.held_out_rms**2 > LARGE * result.noise_floor**2


def _predicts_better(search: Search, base: Fitted, as_given: np.ndarray) -> bool:
    """Whether the refitted nominal model has a lower held-out error than the one as given; so where either has none."""
    fitted = search.held_out(base)
    given = search.fitter.validate(search.fitter.fit(base.hypothesis, as_given, iterations=0))
    return fitted is None or given is None or fitted.rms < given.rms


def only_repeated_rows(verdict: Verdict, rows: RepeatedRows, options: Options) -> bool:
    """Whether rows that were not measured make the mismatch: it is then known, but no effect of the library."""
    return rows.error > options.missed and verdict in (Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY)


def estimates(fitted: Fitted, fitter: Fitter, owner: str) -> dict[str, Estimate]:
    """Values with 95 % intervals of the parameters of one owner ("" the linear structure, else an effect's key).

    A phase is given within half a turn of zero: a fit may have gone round.
    """
    errors = fitted.standard_errors(fitter.noise)
    out = {}
    motion = fitter.nominal.chain.motion
    rows = zip(fitted.hypothesis.entries, fitted.fit.x, errors, *fitted.hypothesis.bounds, strict=True)
    for e, x, s, low, high in rows:
        if e.owner != owner or e.recording > 0 or is_of_start(e.owner, e.name):
            continue
        value = e.si(float(x))
        if e.name == "phase_rad":
            value = math.remainder(value, 2 * math.pi)
        half = half_width(float(s))
        bound = not low + ROUNDING < x < high - ROUNDING
        out[e.name] = Estimate(value, (value - half, value + half), e.quantity.unit(motion), bound)
    return out


def p_values(search: Search, poorer: Fitted, richer: Fitted) -> tuple[float, float, float]:
    """(held-out one-sided p, estimation likelihood-ratio p, gain of chi-square in units of the richer model's variance)."""
    from scipy.special import chdtrc

    held = search.context.compared(poorer, richer).p_value
    gain = richer.n * math.log(poorer.chi2 / richer.chi2)
    extra = max(1, richer.hypothesis.size - poorer.hypothesis.size)
    return held, float(chdtrc(extra, max(gain, 0.0))), gain


def _is_preferred_unseen(search: Search, best: Fitted, other: Fitted) -> bool:
    """Whether another structure without more numbers leaves less on held-out data, and as much on estimation data.

    As much: no more than what a residual at the noise may have above it.
    """
    if other.hypothesis.size > best.hypothesis.size or not other.chi2 <= UNEXPLAINED * best.chi2:
        return False
    mine, its = search.held_out(best), search.held_out(other)
    return mine is not None and its is not None and its.rms < mine.rms


def equivalents(search: Search, best: Fitted, effect: Effect, margin: float = EQUIVALENT) -> dict[str, float]:
    """Identifiers that could stand in this effect's place: same rest of the structure, criterion within ``margin``.

    Each with the held-out rms error of its structure, in the view's unit, NaN where it has none; lowest first. A margin of 10 in
    C is a likelihood ratio of 150; two structures closer than that are not told apart. Nor are two of which the held-out data
    prefer the other one. One that merely refines the effect, and gains nothing by it, is not an equivalent.
    """
    rest = {k for k in best.key if k != effect.key}
    out = []
    for f in search.fits.values():
        others = set(f.key) - rest
        if len(f.key) != len(best.key) or len(others) != 1 or not rest <= set(f.key):
            continue
        (key,) = others
        if key == effect.key or (search.context.ahead(best, f) > margin and not _is_preferred_unseen(search, best, f)):
            continue
        rival = next(e for e in f.effects if e.key == key)
        if rival.name() == effect.name() and rival.place == effect.place:
            continue
        if effect.id in type(rival).refines and f.hypothesis.size > best.hypothesis.size:
            continue
        held = search.held_out(f)
        error = math.inf if held is None or math.isnan(held.rms) else held.rms
        out.append((error, search.criterion(f), rival.name() if rival.name() != effect.name() else rival.key))
    found: dict[str, float] = {}
    for error, _, name in sorted(out):
        found.setdefault(name, error if math.isfinite(error) else math.nan)
    return found
