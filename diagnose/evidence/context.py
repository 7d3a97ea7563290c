"""How structures are compared: the criterion, the effective sample size, and held-out errors.

The criterion compares whitened chi-squares (residual autocorrelation is thereby counted) with a price per parameter:

    C = n log(chi2 / n) + price * (free parameters) + (free numbers of starts)

A number of a start is no part of a structure: it costs the unit of chi-square that it takes of noise.

Nothing here changes what is fitted: what is computed is remembered.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from diagnose.evidence.held_out import Comparison, compare
from diagnose.fit.fits import Fits, Key
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.validation import in_blocks
from diagnose.fit.whiten import effective_share_of_errors, lags_of, whitening_filter
from diagnose.problem.noise_model import KnownNoise, Prices
from diagnose.thresholds import CLEAR, MATERIAL, UNEXPLAINED
from mjsim.effects import Effect, effect_class

__all__ = ["Context", "Memo"]


@dataclass
class Memo:
    """Answers to what was measured once."""

    in_blocks: dict[tuple[object, ...], Comparison] = field(default_factory=dict)
    observed: dict[tuple[Key, float, Key, float], float] = field(default_factory=dict)
    encoder: dict[tuple[object, ...], tuple[float, float]] = field(default_factory=dict)
    speed: dict[tuple[object, ...], float] = field(default_factory=dict)
    beyond: dict[tuple[object, ...], float] = field(default_factory=dict)


@dataclass
class Context:
    """The fits so far by the present weights, and how they compare.

    candidates: how many effects and places the search considers; effective: effective sample size over the number of samples;
    share_between: the same to distinguish two structures (None: every sample is independent).
    """

    fitter: Fitter
    prices: Prices = KnownNoise.prices
    fits: Fits = field(default_factory=Fits)
    candidates: int = 0
    effective: float = 1.0
    share_between: Callable[[Fitted, Fitted], float] | None = None
    memo: Memo = field(default_factory=Memo)

    def criterion(self, f: Fitted) -> float:
        """C of a fitted structure, with a rank among those that nothing tells apart (`_rank`)."""
        n = f.n * self.effective
        return n * math.log(max(f.chi2, 1e-300) / f.n) + self._price(f) + _rank(f)

    def _price(self, f: Fitted) -> float:
        """Price of the free numbers of a structure, those of starts included."""
        return self.prices.price * f.hypothesis.size + f.hypothesis.start_numbers

    def gain(self, poorer: Fitted, richer: Fitted) -> float:
        """How far C falls from one structure to the other, by the effective sample size that distinguishes the two."""
        if self.share_between is None:
            return self.criterion(poorer) - self.criterion(richer)
        price = self._price(richer) - self._price(poorer)
        n = richer.n * self.share_between(poorer, richer)
        ratio = math.log(max(poorer.chi2, 1e-300) / max(richer.chi2, 1e-300))
        return n * ratio - price + _rank(poorer) - _rank(richer)

    def ahead(self, f: Fitted, other: Fitted) -> float:
        """How far C of a structure lies below that of another, both counted from what they have in common."""
        common = self.fits.common(f, other)
        if self.share_between is None or common is None:
            return self.criterion(other) - self.criterion(f)
        mine, theirs = (self.gain(common, g) if common.key != g.key else 0.0 for g in (f, other))
        return mine - theirs

    def unseen_gain(self, poorer: Fitted, richer: Fitted) -> float:
        """What the held-out data add to the gain of C, where the error is the model's own: nothing was fitted to them.

        Such an error leaves few independent samples in any one recording. Nothing is added where the noise is known, nor for a
        structure that has no more effects, or does not leave less of both recordings.
        """
        more = len(richer.effects) > len(poorer.effects) and richer.chi2 < poorer.chi2
        if self.fitter.noise.absolute or self.share_between is None or not more:
            return 0.0
        before, after = self.held_out(poorer), self.held_out(richer)
        if before is None or after is None or after.chi2 >= before.chi2:
            return 0.0
        n = len(after.errors) * effective_share_of_errors(before.errors - after.errors, after.errors, lags_of(self.fitter))
        return n * math.log(before.chi2 / max(after.chi2, 1e-300))

    def held_out(self, f: Fitted) -> HeldOut | None:
        """Held-out error, computed once per structure."""
        return self.fits.held_out(f, self.fitter)

    def compared(self, before: Fitted, after: Fitted) -> Comparison:
        """Two structures on held-out data."""
        self.fitter.map([partial(self.held_out, f) for f in (before, after)])
        return compare(self.held_out(before), self.held_out(after), known=self.fitter.noise.absolute)

    def compared_in_blocks(self, before: Fitted, after: Fitted) -> Comparison | None:
        """Two structures on stretches held out of the estimation recordings; None where the held-out recordings can tell.

        These cannot where the two predict the same on them: if the richer one is right, its gain there is the mean square of
        their difference. What gains much on the recordings that are fitted must then gain on their own held-out stretches.
        """
        material = self.prices.material
        if not self.fitter.noise.absolute or math.log(before.chi2 / after.chi2) < CLEAR * material:
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
        own, and an effect that gains less than ``MATERIAL`` of that beside it may be what the better one still misses.
        """
        spread = 0.0
        for i, effect in enumerate(f.effects):
            if form_of := type(effect).form_of:
                others = [f"{form_of}@{effect.place}" if k == i else e.key for k, e in enumerate(f.effects)]
                spread = max(spread, self._chi2(others, f.chi2) - f.chi2)
        return MATERIAL * spread

    def _chi2(self, keys: Sequence[str], default: float) -> float:
        """Chi-square of a structure where it was fitted."""
        known = self.fits.get(tuple(sorted(keys)))
        return default if known is None else known.chi2

    def floor(self, base: Fitted) -> float:
        """The gain in C that a score test must predict beside a structure, at least the possible error of a law in it."""
        if not base.chi2 > 0:  # nothing is left: a log without noise, of the model itself
            return 0.4 * self.prices.entry
        law = min(self.law_error(base), 0.5 * base.chi2)
        return max(0.4 * self.prices.entry, -base.n * self.effective * math.log(1.0 - law / base.chi2))

    def visible(self, base: Fitted) -> bool:
        """Whether a structure leaves more than noise, or it cannot be known.

        One that leaves less explains a part of what passed for noise (steps of a sensor), so that its level is not known any
        more: then what it leaves must have a colour.
        """
        if not self.fitter.noise.within(base.chi2 / base.n, UNEXPLAINED):
            return True
        return base.chi2 < (2.0 - UNEXPLAINED) * base.n and whitening_filter(self.fitter, base, material=MATERIAL) is not None

    def leaves_noise(self, f: Fitted) -> bool:
        """Whether the residual of a structure is as large as noise and, unless it is whitened, as white: no rival leaves less."""
        if not self.fitter.noise.within(self.fitter.misfit(f), UNEXPLAINED):
            return False
        return len(self.fitter.whitening) > 1 or whitening_filter(self.fitter, f, material=MATERIAL) is None


def _rank(f: Fitted) -> int:
    """By how many units of C a structure comes after one that nothing tells apart from it.

    The first place of an effect stands, and an effect for which MJCF has elements: corrected.xml then moves as found in plain
    MuJoCo. A dead zone and Coulomb friction make the same motion of steps from rest.
    """
    places = (effect_class(e.id).places.index(e.place) for e in f.effects)
    return sum(places) + sum(type(e).native is Effect.native for e in f.effects)
