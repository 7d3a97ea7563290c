"""What structures are compared by: the criterion, the worth of samples, and held-out errors.

The criterion compares whitened chi-squares (residual autocorrelation is thereby counted) with a price per parameter:

    C = n log(chi2 / n) + price * (free parameters)

Nothing here changes what is fitted: what is computed is remembered.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from diagnose.evidence.held_out import Comparison, compare
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.pool import Key, Pool
from diagnose.fit.validation import in_blocks, observed_held_out, predicted_samples
from diagnose.fit.whiten import lags_of, whitening_filter, worth_of_errors
from diagnose.problem.noise_model import KnownNoise, Prices
from diagnose.thresholds import (
    ABOVE_NOISE,
    BELOW_NOISE,
    CLEAR_GAIN,
    COLOURED,
    GAIN_RATIO,
    LAW_ERROR,
    LONG,
    NEXT_TO_NOTHING,
    PUT_RIGHT,
    UNEXPLAINED,
)
from mjsim.effects import effect_class

__all__ = ["Context", "Memo"]


@dataclass
class Memo:
    """Answers to what was measured once."""

    in_blocks: dict[tuple[object, ...], Comparison] = field(default_factory=dict)
    predicted: dict[tuple[object, ...], list[np.ndarray] | None] = field(default_factory=dict)
    observed: dict[tuple[Key, float, Key, float], float] = field(default_factory=dict)
    encoder: dict[tuple[object, ...], tuple[float, float]] = field(default_factory=dict)


@dataclass
class Context:
    """The fits so far by the present weights, and how they compare.

    candidates: how many effects and places the search considers; effective: share of the samples that are worth an independent
    one; worth_of: the same for telling two structures apart (None: every sample is).
    """

    fitter: Fitter
    prices: Prices = KnownNoise.prices
    pool: Pool = field(default_factory=Pool)
    candidates: int = 0
    effective: float = 1.0
    worth_of: Callable[[Fitted, Fitted], float] | None = None
    memo: Memo = field(default_factory=Memo)

    def beside(self, f: Fitted) -> Context:
        """The same with ``f`` standing for its structure."""
        return dataclasses.replace(self, pool=self.pool.beside(f))

    def criterion(self, f: Fitted) -> float:
        """C of a fitted structure; among places that nothing tells apart the first one of the effect's list stands."""
        n = f.n * self.effective
        return n * math.log(max(f.chi2, 1e-300) / f.n) + self.prices.price * len(f.hypothesis.entries) + _rank_of_places(f)

    def gain(self, poorer: Fitted, richer: Fitted) -> float:
        """How far C falls from one structure to the other, each sample counted for what it is worth to tell these two apart."""
        if self.worth_of is None:
            return self.criterion(poorer) - self.criterion(richer)
        price = self.prices.price * (len(richer.hypothesis.entries) - len(poorer.hypothesis.entries))
        n = richer.n * self.worth_of(poorer, richer)
        ratio = math.log(max(poorer.chi2, 1e-300) / max(richer.chi2, 1e-300))
        return n * ratio - price + _rank_of_places(poorer) - _rank_of_places(richer)

    def ahead(self, f: Fitted, other: Fitted) -> float:
        """How far C of a structure lies below that of another, both counted from what they have in common."""
        common = self.pool.common(f, other)
        if self.worth_of is None or common is None:
            return self.criterion(other) - self.criterion(f)
        mine, theirs = (self.gain(common, g) if common.key != g.key else 0.0 for g in (f, other))
        return mine - theirs

    def unseen_gain(self, poorer: Fitted, richer: Fitted) -> float:
        """What the held-out data add to the gain of C, where the error is the model's own: nothing was fitted to them.

        Such an error leaves few independent samples in any one recording. Nothing is added where the noise is known, nor for a
        structure that has no more effects, or does not leave less of both recordings. What is there is there in both: no sample
        counts for more than ``GAIN_RATIO`` times one of the estimation data, to which it was fitted.
        """
        more = len(richer.effects) > len(poorer.effects) and richer.chi2 < poorer.chi2
        if self.fitter.noise.absolute or self.worth_of is None or not more:
            return 0.0
        before, after = self.held_out(poorer), self.held_out(richer)
        if before is None or after is None or after.chi2 >= before.chi2:
            return 0.0
        n = len(after.errors) * worth_of_errors(before.errors - after.errors, after.errors, lags_of(self.fitter))
        fitted, unseen = poorer.chi2 / max(richer.chi2, 1e-300), before.chi2 / max(after.chi2, 1e-300)
        return n * min(math.log(unseen), GAIN_RATIO * math.log(fitted))

    def held_out(self, f: Fitted) -> HeldOut | None:
        """Held-out error, computed once per structure."""
        return self.pool.held_out(f, self.fitter)

    def compared(self, before: Fitted, after: Fitted) -> Comparison:
        """Two structures on held-out data.

        Where one alone fits the estimation data, and its free run diverges: also on the samples that it predicts, and under an
        observer gain. It is right if one of these bears it out, at so many times the p-value, and wrong if all speak against it.
        """
        self.fitter.map([partial(self.held_out, f) for f in (before, after)])
        known = self.fitter.noise.absolute
        views = [compare(self.held_out(before), self.held_out(after), known=known)]
        if self._diverges(before, after):
            views += [compare(*pair, known=known) for pair in self._apart_from_events(before, after)]
        if len(views) == 1:
            return views[0]
        if after.chi2 / after.n > before.chi2 / before.n:
            return max(views, key=lambda c: c.p_value)
        better = min(views, key=lambda c: c.p_value)
        return Comparison(better.relative_gain, min(1.0, len(views) * better.p_value))

    def _diverges(self, *structures: Fitted) -> bool:
        """Whether the free run of a nonsmooth structure, which alone fits the estimation data, diverges on held-out data."""
        fits, other = sorted(structures, key=lambda f: f.chi2 / f.n)
        if not fits.rough or not self.fitter.noise.exceeds(other.chi2 / other.n, UNEXPLAINED):
            return False
        if fits.chi2 > max(
            UNEXPLAINED * fits.n, fits.n + NEXT_TO_NOTHING * (other.chi2 - other.n)
        ):  # nor next to nothing beside the other
            return False
        held = self.held_out(fits)
        return held is not None and held.chi2 > UNEXPLAINED * float(np.sum(held.n))

    def _apart_from_events(self, *structures: Fitted) -> list[list[HeldOut | None]]:
        """Held-out errors of two structures that a wrong moment of an event does not carry.

        On the samples that the one which fits better predicts, and under an observer gain.
        """
        fits = min(structures, key=lambda f: f.chi2 / f.n)
        asked = (fits.key, fits.chi2)
        if asked not in self.memo.predicted:
            self.memo.predicted[asked] = predicted_samples(self.fitter, fits)
        samples, pairs = self.memo.predicted[asked], []
        if samples is not None:
            pairs.append([self.fitter.validate(f, samples) for f in structures])
        observed = [observed_held_out(self.fitter, f, PUT_RIGHT) for f in structures]
        return pairs if None in observed else [*pairs, observed]

    def compared_in_blocks(self, before: Fitted, after: Fitted) -> Comparison | None:
        """Two structures on stretches held out of the estimation recordings; None where the held-out recordings can tell.

        These cannot where the two predict the same on them: if the richer one is right, its gain there is the mean square of
        their difference. What gains much on the recordings that are fitted must then gain on their own held-out stretches.
        """
        material = self.prices.material
        if not self.fitter.noise.absolute or math.log(before.chi2 / after.chi2) < CLEAR_GAIN * material:
            return None
        pair = (self.held_out(before), self.held_out(after))
        if pair[0] is None or pair[1] is None or self.compared(before, after).relative_gain < -material:
            return None
        expected = float(np.sum((pair[0].errors - pair[1].errors) ** 2)) / pair[1].chi2
        parts = in_blocks(self.fitter) if expected < 2 * material else None
        if parts is None:
            return None
        key = (before.key, before.chi2, after.key, after.chi2)
        if key not in self.memo.in_blocks:
            fits = parts.map([partial(parts.fit, f.hypothesis, f.fit.x, iterations=15) for f in (before, after)])
            self.memo.in_blocks[key] = compare(*(parts.validate(f) for f in fits), known=True)
        return self.memo.in_blocks[key]

    def law_error(self, f: Fitted) -> float:
        """How much chi-square beside a structure may be the error of a law that it holds in place of the contract's own.

        Where another law of an effect fits better, what that changed tells how much there is in a law. Neither is the machine's
        own, and an effect that gains less than ``LAW_ERROR`` of that beside it may be what the better one still misses.
        """
        spread = 0.0
        for i, effect in enumerate(f.effects):
            if form_of := type(effect).form_of:
                others = [f"{form_of}@{effect.place}" if k == i else e.key for k, e in enumerate(f.effects)]
                spread = max(spread, self.pool.least(tuple(sorted(others)), f.chi2) - f.chi2)
        return LAW_ERROR[0] * spread + LAW_ERROR[1] * min(spread, f.n)

    def floor(self, base: Fitted) -> float:
        """The gain in C that an effect must promise beside a structure: more where that much may be the error of a law in it."""
        law = min(self.law_error(base), 0.5 * base.chi2)
        return max(0.4 * self.prices.entry, -base.n * self.effective * math.log(1.0 - law / base.chi2))

    def visible(self, base: Fitted) -> bool:
        """Whether a structure leaves more than noise, or it cannot be known.

        One that leaves less explains a part of what passed for noise (steps of a sensor), so that its level is not known any
        more: then what it leaves must have a colour.
        """
        if not self.fitter.noise.within(base.chi2 / base.n, ABOVE_NOISE):
            return True
        return base.chi2 < BELOW_NOISE * base.n and whitening_filter(self.fitter, base, material=COLOURED) is not None

    def leaves_noise(self, f: Fitted) -> bool:
        """Whether the residual of a structure is as large as noise and, unless it is whitened, as white: no rival leaves less."""
        if not self.fitter.noise.within(self.fitter.misfit(f), UNEXPLAINED):
            return False
        return len(self.fitter.whitening) > 1 or whitening_filter(self.fitter, f, material=COLOURED) is None

    def solved(self, poorer: Fitted, richer: Fitted) -> bool:
        """Whether a structure leaves noise alone, or much less than one did that left what passed for noise."""
        passed = self.fitter.noise.within(self.fitter.misfit(poorer), UNEXPLAINED)
        return self.leaves_noise(richer) or (passed and richer.chi2 < 0.5 * poorer.chi2)

    def slow(self, f: Fitted) -> bool:
        """Whether a run of a structure takes so long that it is fitted no more often than it must."""
        return self.fitter.length(f.hypothesis, f.fit.x) > LONG


def _rank_of_places(f: Fitted) -> int:
    return sum(effect_class(e.id).places.index(e.place) for e in f.effects)
