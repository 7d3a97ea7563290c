"""Whether one structure is better than another: by the criterion, on held-out data, and against what may stand in for it.

The criterion compares whitened chi-squares (residual autocorrelation is thereby counted) with a price per parameter:

    C = n log(chi2 / n) + price * (free parameters)

Thresholds: docs/decisions/false-alarms.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from diagnose.evidence.encoder import encoder_gain, gain_beside_encoder
from diagnose.evidence.force_orders import FEW
from diagnose.evidence.held_out import Comparison, compare
from diagnose.fit.fitted import UNEXPLAINED, Fitted, HeldOut, key_of
from diagnose.fit.fitter import CLOSELY, SAME, Fitter
from diagnose.fit.whiten import lags_of, whitening_filter, worth_of_errors
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import Candidate
from diagnose.structure.moves import named
from mjsim.effects import effect_class

__all__ = ["LACKS", "LEAD", "LONG", "SHAKEN", "Judge"]

LEAD = 30.0  # rate [1/s] at which a led model is drawn to the measured velocity, where rivals that stick or strike are judged
BETWEEN = 100.0  # a rate on the way to it from one that leads closely
FAIR = 0.25  # part of what is left, and in a led model of its gain, that an effect beside one that sticks or strikes must explain
SHOWN = 10.0  # times the material gain, on the estimation data, of an effect that held-out data may be too few for
ANSWERED = 0.5  # of the squared error: more is not the answer of a servo to unknown torques (lab/speed/servo_axes.py)
CLEAR = 0.8  # of the squared error: so much of a model's own error no sine of a few periods takes by chance
IMITATED = {"signal", "coupling", "structure", "offset"}  # families of effects that look like such an answer
SPREAD = (
    4.0  # ratio of an effect's logarithmic gains in two recordings of some 15 independent samples each (2 standard deviations)
)
LACKS = 4.0  # times the noise variance left by a closely led model, which no wrong order of events leaves
STAYS = 0.5  # part of what is left beside noise that stays when a model is led, and is then none of other moments
NEXT = 0.01  # of what one structure leaves above noise, that is next to nothing of it in another
PUT_RIGHT = 56.0  # rate [1/s] at which a led model is put right before the next event
LONG = 8.0  # times a run of the nominal model with friction, above which a structure is slow to run
SHORT = 2.0  # the same, up to which one is shaken wherever it has landed
SHAKEN = 2.0  # times the noise variance that a structure may leave, to be looked for lower minima about it
LAW = (0.01, 0.02)  # part of what another law of an effect changed that the better law may still miss: of all, and besides of
# what is no more than the noise variance
COLOURED = 0.01  # of its variance, by which a residual foretells itself
MOVED = 1e-3  # of a number's size, by which another fit of a structure is another guess of it
ALIKE = 0.02  # part of an effect's gain by which it has to beat a rival that is noise: two laws of one motion are not closer


Key = tuple[str, ...]


def _alike(asked: tuple[Key, float, Key, float], before: Fitted, after: Fitted) -> bool:
    """Whether two structures are those that were asked about, by keys and chi-squares, but for the last digits of a fit."""
    same = (asked[0], asked[2]) == (before.key, after.key)
    return same and all(abs(math.log(f.chi2 / known)) < SAME for f, known in ((before, asked[1]), (after, asked[3])))


@dataclass
class Judge:
    """Everything fitted so far, by structure, and how it compares."""

    fitter: Fitter
    options: SearchOptions
    pool: dict[tuple[str, ...], Fitted] = field(default_factory=dict)
    held: dict[tuple[str, ...], HeldOut | None] = field(default_factory=dict)
    candidates: tuple[Candidate, ...] = ()
    effective: float = 1.0
    worth_of: Callable[[Fitted, Fitted], float] | None = None
    _encoder: dict[tuple[object, ...], bool] = field(default_factory=dict, init=False)
    _in_blocks: dict[tuple[object, ...], Comparison] = field(default_factory=dict, init=False)
    _leads: dict[tuple[Key, float, Key, float], float] = field(default_factory=dict, init=False)
    _samples: dict[tuple[object, ...], list[np.ndarray] | None] = field(default_factory=dict, init=False)
    _least: dict[tuple[str, ...], float] = field(default_factory=dict, init=False)  # whatever has left the pool
    _shaken: set[tuple[object, ...]] = field(default_factory=set, init=False)
    _begun_beside: dict[tuple[object, ...], Fitted] = field(default_factory=dict, init=False)
    _begun_richer: dict[tuple[object, ...], Fitted | None] = field(default_factory=dict, init=False)
    _landed: set[tuple[object, ...]] = field(default_factory=set, init=False)
    _without: set[tuple[object, ...]] = field(default_factory=set, init=False)  # structures begun at a richer one's numbers

    def criterion(self, f: Fitted) -> float:
        """C of a fitted structure; among places that nothing tells apart the first one of the effect's list stands."""
        order = sum(effect_class(e.id).places.index(e.place) for e in f.effects)
        n = f.n * self.effective
        return n * math.log(max(f.chi2, 1e-300) / f.n) + self.options.price * len(f.hypothesis.entries) + order

    def gain(self, poorer: Fitted, richer: Fitted) -> float:
        """How far C falls from one structure to the other, each sample counted for what it is worth to tell these two apart."""
        if self.worth_of is None:
            return self.criterion(poorer) - self.criterion(richer)
        order = [sum(effect_class(e.id).places.index(e.place) for e in f.effects) for f in (poorer, richer)]
        price = self.options.price * (len(richer.hypothesis.entries) - len(poorer.hypothesis.entries))
        n = richer.n * self.worth_of(poorer, richer)
        return n * math.log(max(poorer.chi2, 1e-300) / max(richer.chi2, 1e-300)) - price + order[0] - order[1]

    def ahead(self, f: Fitted, other: Fitted) -> float:
        """How far C of a structure lies below that of another, both counted from what they have in common."""
        common = self.pool.get(tuple(sorted(set(f.key) & set(other.key))))
        if self.worth_of is None or common is None:
            return self.criterion(other) - self.criterion(f)
        mine, theirs = (self.gain(common, g) if common.key != g.key else 0.0 for g in (f, other))
        return mine - theirs

    def foretold(self, poorer: Fitted, richer: Fitted) -> float:
        """What the held-out data add to the gain of C, where the error is the model's own: nothing was fitted to them.

        Such an error leaves few independent samples in any one recording. Nothing is added where the noise is known, nor for a
        structure that has no more effects, or does not leave less of both recordings. What is there is there in both: no sample
        counts for more than ``SPREAD`` times one of the estimation data, to which it was fitted.
        """
        more = len(richer.effects) > len(poorer.effects) and richer.chi2 < poorer.chi2
        if self.fitter.noise.absolute or self.worth_of is None or not more:
            return 0.0
        before, after = self.held_out(poorer), self.held_out(richer)
        if before is None or after is None or after.chi2 >= before.chi2:
            return 0.0
        n = len(after.errors) * worth_of_errors(before.errors - after.errors, after.errors, lags_of(self.fitter))
        fitted, unseen = poorer.chi2 / max(richer.chi2, 1e-300), before.chi2 / max(after.chi2, 1e-300)
        return n * min(math.log(unseen), SPREAD * math.log(fitted))

    def held_out(self, f: Fitted) -> HeldOut | None:
        """Held-out error, computed once per structure."""
        if f.key not in self.held:
            self.held[f.key] = self.fitter.validate(f)
        return self.held[f.key]

    def compared(self, before: Fitted, after: Fitted) -> Comparison:
        """Two structures on held-out data.

        Where one alone fits the estimation data, and its free run goes astray: also on what that one foretells, and as led
        models. It is right if one of these bears it out, at so many times the p-value, and wrong if all speak against it.
        """
        self.fitter.map([partial(self.held_out, f) for f in (before, after)])
        known = self.fitter.noise.absolute
        views = [compare(self.held_out(before), self.held_out(after), known=known)]
        if self._astray(before, after):
            views += [compare(*pair, known=known) for pair in self._beside_events(before, after)]
        if len(views) == 1:
            return views[0]
        if after.chi2 / after.n > before.chi2 / before.n:
            return max(views, key=lambda c: c.p_value)
        better = min(views, key=lambda c: c.p_value)
        return Comparison(better.relative_gain, min(1.0, len(views) * better.p_value))

    def _astray(self, *structures: Fitted) -> bool:
        """Whether the free run goes astray on held-out data of a structure that sticks or strikes, and alone fits the others."""
        fits, other = sorted(structures, key=lambda f: f.chi2 / f.n)
        if not self.fitter.noise.absolute or not fits.rough or other.chi2 < UNEXPLAINED * other.n:
            return False
        if fits.chi2 > max(UNEXPLAINED * fits.n, fits.n + NEXT * (other.chi2 - other.n)):  # nor next to nothing beside the other
            return False
        held = self.held_out(fits)
        return held is not None and held.chi2 > UNEXPLAINED * float(np.sum(held.n))

    def _beside_events(self, *structures: Fitted) -> list[list[HeldOut | None]]:
        """Held-out errors of two structures that a wrong moment of an event does not carry.

        On the samples that the one which fits better foretells, and of led models.
        """
        fits = min(structures, key=lambda f: f.chi2 / f.n)
        asked = (fits.key, fits.chi2)
        if asked not in self._samples:
            self._samples[asked] = self.fitter.foretold(fits)
        samples, pairs = self._samples[asked], []
        if samples is not None:
            pairs.append([self.fitter.validate(f, samples) for f in structures])
        led = [self.fitter.led_held_out(f, PUT_RIGHT) for f in structures]
        return pairs if None in led else [*pairs, led]

    def pays(self, before: Fitted, after: Fitted, attempt: int = 1) -> bool:
        """Whether ``after`` is better by the criterion, materially, and on held-out data.

        ``attempt``: how many structures the held-out data have been asked about in this move, this one included. It was the
        estimation data that chose them among the candidates, so that where the noise is known only these are corrected for;
        where the error is the model's own, which both share, all candidates are.
        """
        if self.gain(before, after) + self.foretold(before, after) < self.options.entry:
            return False
        if after.chi2 > before.chi2 - self.of_the_law(before) and set(before.key) < set(after.key):
            return False
        asked = self.fitter.noise.hypotheses(attempt, len(self.candidates))
        if not self._pays_on(self.compared(before, after), asked) and not self._pays_in_blocks(before, after, asked):
            again = self._begun_from(before, after)
            if again is None or not self._pays_again(before, again, 2 * asked):
                return False
            after = again
        if self._feedback_does(before, after) or self._of_few_periods(before, after):
            return False
        if self._encoder_errs(before, after) or self._events_only(before, after):
            return False
        lower = self._beside(before, after)
        return lower is before or self.pays(lower, after, attempt)

    def of_the_law(self, f: Fitted) -> float:
        """How much chi-square beside a structure may be the error of a law that it holds in place of the contract's own.

        Where another law of an effect fits better, what that changed tells how much there is in a law. Neither is the machine's
        own, and an effect that gains less than ``LAW`` of that beside it may be what the better one still misses.
        """
        spread = 0.0
        for i, effect in enumerate(f.effects):
            if form_of := type(effect).form_of:
                others = [f"{form_of}@{effect.place}" if k == i else e.key for k, e in enumerate(f.effects)]
                spread = max(spread, self._least.get(tuple(sorted(others)), f.chi2) - f.chi2)
        return LAW[0] * spread + LAW[1] * min(spread, f.n)

    def floor(self, base: Fitted) -> float:
        """The gain in C that an effect must promise beside a structure: more where that much may be the error of a law in it."""
        law = min(self.of_the_law(base), 0.5 * base.chi2)
        return max(0.4 * self.options.entry, -base.n * self.effective * math.log(1.0 - law / base.chi2))

    def visible(self, base: Fitted) -> bool:
        """Whether a structure leaves more than noise, or it cannot be known.

        One that leaves less explains a part of what passed for noise (steps of a sensor), so that its level is not known any
        more: then what it leaves must have a colour.
        """
        if not self.fitter.noise.within(base.chi2 / base.n, 1.05):
            return True
        return base.chi2 < 0.95 * base.n and whitening_filter(self.fitter, base, material=COLOURED) is not None

    def leaves_noise(self, f: Fitted) -> bool:
        """Whether what a structure leaves is as large as noise and, unless it is whitened, as white: no rival leaves less."""
        if not self.fitter.noise.within(self.fitter.misfit(f), UNEXPLAINED):
            return False
        return len(self.fitter.whitening) > 1 or whitening_filter(self.fitter, f, material=COLOURED) is None

    def solved(self, poorer: Fitted, richer: Fitted) -> bool:
        """Whether a structure leaves noise alone, or much less than one did that left what passed for noise."""
        return self.leaves_noise(richer) or (
            self.fitter.noise.within(self.fitter.misfit(poorer), UNEXPLAINED) and richer.chi2 < 0.5 * poorer.chi2
        )

    def _feedback_does(self, before: Fitted, after: Fitted) -> bool:
        """Whether what was added may be the controller's answer to disturbances, where the error is the model's own.

        A servo answers a torque that no model knows of, late and in proportion: what the command lacks then looks like a delay, a
        lag, a dead zone or a spring, and a slow one like an offset. Of the squared error that took away at most ``ANSWERED``.
        A law of which the data leave a size open is one of those as well: bristles that never slide are a spring.
        """
        if self.fitter.noise.absolute:
            return False
        added = [e for e in after.effects if e.key not in before.key]
        if not any(type(e).family in IMITATED for e in added) and not self._open(after, {e.key: e.amplitudes for e in added}):
            return False
        share = min(1.0 - after.chi2 / before.chi2, self.compared(before, after).relative_gain)
        return share < ANSWERED

    def _of_few_periods(self, before: Fitted, after: Fitted) -> bool:
        """Whether what was added repeats so few times over the travel that a slow error of the model could look like it.

        Where the error is the model's own an order must stand out of those beside it; one of so few periods has none beside it.
        It has to take most (``CLEAR``) of the squared error, on both recordings.
        """
        if self.fitter.noise.absolute:
            return False
        few = 2 * math.pi * FEW
        orders = {
            e: e.values["cycles_per_rev"] for e in after.effects if e.key not in before.key and "cycles_per_rev" in e.values
        }
        if not any(n * self.fitter.scales[type(e).angle_of or e.place].travel < few for e, n in orders.items()):
            return False
        return min(1.0 - after.chi2 / before.chi2, self.compared(before, after).relative_gain) < CLEAR

    def _open(self, f: Fitted, sizes: Mapping[str, tuple[str, ...]]) -> bool:
        """Whether the 95 % interval of one of the sizes of effects, by key, holds zero."""
        errors = f.standard_errors(self.fitter.noise)
        return any(
            abs(e.si(float(x))) < 1.96 * float(s)
            for e, x, s in zip(f.hypothesis.entries, f.fit.x, errors, strict=True)
            if e.name in sizes.get(e.owner, ())
        )

    def _pays_on(self, c: Comparison, asked: int) -> bool:
        return c.relative_gain > self.options.material and c.p_value * asked < self.options.p_enter

    def _pays_in_blocks(self, before: Fitted, after: Fitted, asked: int) -> bool:
        """Whether a structure pays on stretches held out of the estimation recordings, where the held-out ones cannot tell.

        These cannot where the two predict the same on them: if the richer one is right, its gain there is the mean square of
        their difference. What gains much on the recordings that are fitted must then pay on their own held-out stretches.
        """
        if not self.fitter.noise.absolute or math.log(before.chi2 / after.chi2) < SHOWN * self.options.material:
            return False
        pair = (self.held_out(before), self.held_out(after))
        if pair[0] is None or pair[1] is None or self.compared(before, after).relative_gain < -self.options.material:
            return False
        expected = float(np.sum((pair[0].errors - pair[1].errors) ** 2)) / pair[1].chi2
        parts = self.fitter.in_blocks() if expected < 2 * self.options.material else None
        if parts is None:
            return False
        key = (before.key, before.chi2, after.key, after.chi2)
        if key not in self._in_blocks:
            fits = parts.map([partial(parts.fit, f.hypothesis, f.fit.x, iterations=15) for f in (before, after)])
            self._in_blocks[key] = compare(*(parts.validate(f) for f in fits), known=True)
        return self._pays_on(self._in_blocks[key], asked)

    def hardly_exercised(self, f: Fitted, key: str) -> bool:
        """Whether an effect of a structure pays on stretches of the estimation recordings alone."""
        poorer = self.pool.get(tuple(k for k in f.key if k != key))
        return poorer is not None and not self._pays_on(self.compared(poorer, f), 1) and self._pays_in_blocks(poorer, f, 1)

    def keep(self, f: Fitted) -> None:
        """Put a fit in the pool, unless a better one of its structure is there."""
        old = self.pool.get(f.key)
        if f.ok:
            self._least[f.key] = min(f.chi2, self._least.get(f.key, math.inf))
        if f.ok and (old is None or f.chi2 < old.chi2):
            self.pool[f.key] = f
            self.held.pop(f.key, None)

    def shake(self, f: Fitted) -> Fitted:
        """A structure in which bodies stick or strike at the lowest minimum about it, where it leaves little more than noise."""
        if not self.options.free or not f.rough or not self.fitter.noise.within(f.chi2 / f.n, SHAKEN):
            return f
        asked = (f.key, f.chi2, self.fitter.guide, self.fitter.whitening.tobytes())
        if asked not in self._shaken:
            lower = self.fitter.shaken(f)
            self._shaken |= {asked, (f.key, lower.chi2, *asked[2:])}
            self.keep(lower)
        known = self.pool.get(f.key, f)
        return known if known.chi2 < f.chi2 else f

    def _begun_at(self, richer: Fitted, poorer: Fitted, iterations: int) -> Fitted:
        """A poorer structure begun at the numbers of a richer one."""
        effects = tuple(e for e in richer.effects if e.key in poorer.key)
        return self.fitter.fit(self.fitter.hypothesis(effects, richer.linear, richer.own), iterations=iterations)

    def _left_out(self, key: Key, richer: Fitted) -> tuple[object, ...]:
        """That a structure was begun at the numbers of a richer one."""
        return key, richer.key, round(math.log(richer.chi2), 2)

    def _slow(self, f: Fitted) -> bool:
        """Whether a run of a structure takes so long that it is fitted no more often than it must."""
        return self.fitter.length(f.hypothesis, f.fit.x) > LONG

    def _brought_down(self, f: Fitted) -> None:
        """Land a structure that sticks or strikes, and shake it, where its runs are short enough: once, from where it is."""
        if not self.options.free or not self.fitter.noise.absolute or self.fitter.view.channel != "velocity":
            return
        length = self.fitter.length(f.hypothesis, f.fit.x)
        asked = (f.key, self.fitter.guide, round(math.log(f.chi2), 1))
        if asked in self._landed or length > LONG:
            return
        self._landed.add(asked)
        landed = self.fitter.landed(f)
        if landed is not None:
            self.keep(landed)
        if length < SHORT:
            self.shake(self.pool.get(f.key, f))

    def _begun_from(self, before: Fitted, after: Fitted) -> Fitted | None:
        """A richer structure begun at the numbers that a poorer one has come to since, once; None where that is worse.

        Held-out data may ask more of a number than the others tell of it: then they compare two guesses of it, and not the
        structures. Of two fits that the estimation data do not tell apart the one that shares the poorer's numbers is compared.
        """
        much = math.log(before.chi2 / after.chi2) > SHOWN * self.options.material
        if not self.fitter.noise.absolute or after.rough or not set(before.key) < set(after.key) or not much:
            return None
        if self.compared(before, after).relative_gain > -self.options.material:
            return None  # that is no error of a number
        asked = (before.key, before.chi2, after.key, after.chi2)
        if asked not in self._begun_richer:
            new = [e for e in after.effects if e.key not in before.key]
            h = self.fitter.hypothesis((*before.effects, *new), before.linear, before.own)
            begun = self.fitter.fit(h, iterations=12)
            alike = begun.ok and begun.chi2 < after.chi2 + self.options.entry
            by_place = [dict(zip((e.label for e in f.hypothesis.entries), f.fit.x, strict=True)) for f in (begun, after)]
            moved = max(abs(x - by_place[1][label]) for label, x in by_place[0].items())
            self._begun_richer[asked] = begun if alike and moved > MOVED else None
        return self._begun_richer[asked]

    def _pays_again(self, before: Fitted, again: Fitted, asked: int) -> bool:
        """Whether a richer structure pays by another fit of it, which then stands for it."""
        fit, held = self.pool.get(again.key), self.held.pop(again.key, None)
        self.pool[again.key] = again
        if self._pays_on(self.compared(before, again), asked) or self._pays_in_blocks(before, again, asked):
            return True
        del self.pool[again.key], self.held[again.key]
        if fit is not None:
            self.pool[again.key], self.held[again.key] = fit, held
        return False

    def _beside(self, before: Fitted, after: Fitted) -> Fitted:
        """A structure in which bodies stick or strike, begun where a richer one has led; itself where that is no better.

        Of its minima it may have missed the one to which the richer one has come by another way. One that leaves little more than
        noise is landed as well: a minute gain may be that of an event a sample sooner.
        """
        if not before.rough or not self.fitter.noise.absolute or not set(before.key) < set(after.key):
            return before
        asked = (before.key, before.chi2, after.key, after.chi2)
        if asked not in self._begun_beside:
            if before.chi2 < SHAKEN * before.n:
                self._brought_down(before)
            begun = [] if self._left_out(before.key, after) in self._without else [self._begun_at(after, before, 20)]
            landed = min(before, self.pool.get(before.key, before), key=lambda f: f.chi2)
            self._begun_beside[asked] = min((self.shake(f) for f in (*begun, landed) if f.ok), key=lambda f: f.chi2)
        lower = self._begun_beside[asked]
        self.keep(lower)
        return lower if lower.chi2 < before.chi2 - 1.0 else before

    def _events_only(self, before: Fitted, after: Fitted) -> bool:
        """Whether what was added to a structure in which bodies stick or strike only brings its events into another order.

        A free run that sticks once too often is wrong from there on, and whatever moves that event gains much. A led model is put
        right within 1 / rate: there it must gain as well, a fair part of that. Of more than noise it must explain a fair part.
        """
        if not before.rough or not self.fitter.noise.absolute or not set(before.key) < set(after.key):
            return False
        gain = self.gain(before, after)
        if before.chi2 > UNEXPLAINED * before.n and gain < FAIR * before.n * math.log(before.chi2 / before.n):
            return True
        asked = next((a for a in self._leads if _alike(a, before, after)), (before.key, before.chi2, after.key, after.chi2))
        if asked not in self._leads:
            richer, own = (self.fitter.led(f, LEAD, 15, spread=0 if self._slow(f) else 8, keep=2) for f in (after, before))
            begun = self._begun_at(after, before, 0)
            poorer = [f for f in (own, self.fitter.led(begun, LEAD, 15) if begun.ok else None) if f is not None]
            if richer is None or not poorer:
                self._leads[asked] = math.inf
            else:
                self._leads[asked] = self.gain(min(poorer, key=lambda f: f.chi2), richer)
        return self._leads[asked] < max(self.options.entry, FAIR * gain)

    def lacks_more(self, f: Fitted) -> bool:
        """Whether a structure lacks something else than the moments at which bodies stick, or a turn of an oscillation."""
        # led closely, what the motion was is nearly given, and the error is that of the torques: it has hardly any minima but one
        led = self.fitter.led(f, self._closely(f), 20) if self.fitter.noise.absolute else None
        return led is not None and led.chi2 > LACKS * led.n

    def lacks_law(self, f: Fitted) -> bool:
        """Whether what a structure leaves beside noise is no wrong order of its events: where that is little, and stays when led.

        A led model is put right within 1 / rate, so that an event at another moment costs it a fraction of what a free run pays.
        It is led closely first, where it has hardly any minima but one: begun at the free run's it may stay where that is.
        """
        f = self.pool.get(f.key, f)
        if not f.rough or not self.fitter.noise.within(f.chi2 / f.n, SHAKEN):
            return False
        stays = f.n + STAYS * (f.chi2 - f.n)
        led = self.fitter.led(f, LEAD, 20)
        for rate in (self._closely(f), BETWEEN, LEAD) if led is not None and led.chi2 > stays else ():
            led = self.fitter.led(led or f, rate, 20)
        return led is not None and led.chi2 > stays

    def sticks(self, f: Fitted) -> bool:
        """Whether bodies stick or strike in a structure to some effect."""
        bare = self.pool.get(key_of(tuple(e for e in f.effects if not type(e).rough))) if f.rough else None
        return f.rough and (bare is None or f.chi2 < 0.9 * bare.chi2)

    def _closely(self, *structures: Fitted) -> float:
        """The rate [1/s] at which structures are led closely: that of the lightest driven body among them."""
        nominal = self.fitter.nominal.chain.bodies[0].inertia
        return CLOSELY * min(1.0, *(f.axis.chain.bodies[0].inertia / nominal for f in structures))

    def beaten(self, f: Fitted, current: Fitted) -> bool:
        """Whether a structure stays behind another one when both are led, so that it is behind by no wrong minimum alone."""
        if not self.fitter.noise.absolute:
            return False
        rate = self._closely(f, current)
        mine, best = self.fitter.map([partial(self.fitter.led, g, rate, 20) for g in (f, current)])
        return mine is not None and best is not None and self.gain(mine, best) > self.options.entry

    def _encoder_errs(self, before: Fitted, after: Fitted) -> bool:
        """Whether an encoder that errs over its turn does as much as the one effect that was added.

        At whole orders of its turn it may err beside any effect, which must gain there too; and at whatever order a
        position-locked effect has it is that effect's rival.
        """
        new = [e for e in after.effects if e.key not in before.key]
        if len(new) != 1 or len(after.key) != len(before.key) + 1 or not self.fitter.noise.absolute:
            return False
        asked = (before.key, before.chi2, new[0], after.chi2)
        if asked not in self._encoder:
            gain = before.chi2 - after.chi2
            own = encoder_gain(self.fitter, before, new[0]) > gain - max(self.options.entry, ALIKE * gain)
            self._encoder[asked] = own or gain_beside_encoder(self.fitter, before, after) < self.options.entry
        return self._encoder[asked]

    def earned(self, current: Fitted, f: Fitted) -> bool:
        """Whether a structure beats another directly, and what it alone has pays by itself, where the error is the model's own.

        Two gains counted from far off, each by its own samples' worth, say little of their difference; and an effect that does
        not pay beside the rest must not enter in exchange for one that does.
        """
        common = self.pool.get(tuple(sorted(set(f.key) & set(current.key))))
        if self.worth_of is None or common is None or common.key == f.key:
            return True
        directly = self.gain(current, f) if f.chi2 < current.chi2 else -self.gain(f, current)
        return directly > 0 and self.pays(common, f)

    def worse(self, f: Fitted, other: Fitted) -> bool:
        """Whether held-out data speak for a structure and against another of its size that fits the estimation data better."""
        c = self.compared(other, f)
        return c.relative_gain > self.options.material and c.p_value < self.options.p_enter

    def stands(self, simpler: Fitted, current: Fitted) -> bool:
        """Whether another law of what the simpler structure names as well beats it, and not on the estimation data alone."""
        if named(simpler) != named(current) or self.gain(simpler, current) < self.options.entry:
            return False
        return self.compared(simpler, current).relative_gain > 0.0
