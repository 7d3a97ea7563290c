"""Continuation of nonsmooth and multimodal structures: from relaxed problems to the free run, and restarts about a fit.

A free run has many minima, and a fit ends in the one next to its start. With stick-slip or impacts there is one for each order of
the events. Relaxed problems (an observer gain that falls, a horizon that grows) have fewer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from diagnose.fit import path
from diagnose.fit.fitted import Fitted, key_of
from diagnose.fit.least_squares import Status
from diagnose.structure.moves import folded
from diagnose.structure.state import State
from diagnose.thresholds import (
    BETWEEN,
    HORIZON_ROUNDS,
    LACKS,
    LEAD,
    LITTLE,
    NEARBY,
    RELEASES,
    RESTARTED_BELOW,
    RIVAL,
    SAME,
    SHORT,
    SMOOTH,
    STAYS,
    UNEXPLAINED,
    WIDE,
)

__all__ = ["Continuation"]


@dataclass
class Continuation:
    """Lower minima of structures that have been fitted; what it finds goes into the pool."""

    state: State
    _restarted: set[tuple[object, ...]] = field(default_factory=set, init=False)
    _landed: set[tuple[object, ...]] = field(default_factory=set, init=False)

    def restart(self, f: Fitted) -> Fitted:
        """A nonsmooth structure at the lowest minimum about it, by its covariance, where it leaves little more than noise."""
        fitter, pool = self.state.fitter, self.state.pool
        if not self.state.options.free or not f.rough or not fitter.noise.within(f.chi2 / f.n, RESTARTED_BELOW):
            return f
        asked = (f.key, f.chi2, fitter.prior_weight, fitter.whitening.tobytes())
        if asked not in self._restarted:
            lower = path.restarted_about(fitter, f)
            self._restarted |= {asked, (f.key, lower.chi2, *asked[2:])}
            self.state.keep(lower)
        known = pool.newest(f)
        return known if known.chi2 < f.chi2 else f

    def land(self, f: Fitted) -> None:
        """Fit a nonsmooth structure by falling observer gains, and restart it if its runs are short: once, from where it is."""
        fitter = self.state.fitter
        if not self.state.options.free or not fitter.noise.absolute or fitter.view.channel != "velocity":
            return
        asked = (f.key, fitter.prior_weight, round(math.log(f.chi2), 1))
        if asked in self._landed or self.state.context.slow(f):
            return
        self._landed.add(asked)
        landed = path.landed(fitter, f)
        if landed is not None:
            self.state.keep(landed)
        if fitter.length(f.hypothesis, f.fit.x) < SHORT:
            self.restart(self.state.pool.newest(f))

    def land_near(self, running: Sequence[Fitted], base: Fitted) -> None:
        """Land nonsmooth rivals near the best; not what is first and leaves noise alone.

        A free run of theirs ends in the minimum next to its start, and which of them comes first is then chance. Those that are
        nonsmooth by their base alone, which has landed, are left as they are.
        """
        state, fitter, pool = self.state, self.state.fitter, self.state.pool
        if not fitter.noise.absolute:
            return
        new = list(running)
        if base.rough and base.chi2 < RESTARTED_BELOW * base.n:
            new = [f for f in running if any(type(e).rough and e.key not in base.key for e in f.effects)]
        for f in (*new, *new):  # one that was first may not be when the others have landed
            f, best = pool.newest(f), min((pool.newest(g) for g in running), key=lambda g: g.chi2)
            criterion = state.context.criterion
            behind = criterion(f) - criterion(best) > state.options.entry or fitter.misfit(f) > UNEXPLAINED
            near = f.rough and f.chi2 < NEARBY * min(best.chi2, base.chi2) and behind
            if near and not state.spent():
                self.land(f)

    def smoothed(self, f: Fitted) -> Fitted:
        """A structure once more by wide secants where its cost is nonsmooth: they see past the steps.

        An event comes a sample sooner or later as a parameter moves, and the error jumps.
        """
        fitter = self.state.fitter
        nonsmooth = f.fit.status is Status.STALLED or f.rough
        if not nonsmooth or not fitter.noise.exceeds(f.chi2 / f.n, SMOOTH) or self.state.context.slow(f):
            return f
        for step in WIDE:
            wide = fitter.fit(f.hypothesis, f.fit.x, iterations=8, step=step, tolerance=1e-4)
            if wide.ok and wide.chi2 < f.chi2:
                f = wide
        return f

    def grow(self, structures: Sequence[Fitted], beside: Fitted | None = None, most: int = HORIZON_ROUNDS) -> None:
        """Fit multimodal structures that leave more than noise over growing horizons, then by homotopy in the observer gain.

        Not those that lack something else under an observer gain, nor those that stay behind ``beside`` there. ``most``: how
        often one may go through the homotopy.
        """
        state = self.state
        for f in structures if state.options.free and not state.late() else ():
            known = state.horizons.get(f.key)
            exceeds = state.fitter.noise.exceeds(f.chi2 / f.n, UNEXPLAINED)
            if not exceeds or (known or 0) >= most or not folded(f):
                continue
            state.horizons[f.key] = HORIZON_ROUNDS
            if not state.late() and self.restart(f).chi2 < UNEXPLAINED * f.n:
                continue
            if self.lacks_more(f) or self.lacks_law(f) or (beside is not None and f.key != beside.key and self.beaten(f, beside)):
                continue
            since = state.fitter.runs
            if known is None:
                self._over_horizons(f)
            self._release(f, known or 0, most)
            state.charge_half(since)

    def _over_horizons(self, f: Fitted) -> None:
        """Growing horizons, from the fitted and from the nominal linear parameters, while it gains."""
        state = self.state
        for linear in (f.linear, None):
            for _ in range(HORIZON_ROUNDS):
                last = state.pool.newest(f)
                if state.late() or last.chi2 < UNEXPLAINED * last.n:
                    break
                now = path.over_horizons(state.fitter, last, linear)
                state.keep(now)
                if not now.ok or now.chi2 > 0.9 * last.chi2:
                    break
                linear = now.linear

    def _release(self, f: Fitted, first: int, most: int) -> None:
        """Homotopy to the free run of a nonsmooth structure, with other draws each time, until it comes back to what is known."""
        state = self.state
        for seed in range(first, most):
            last = state.pool.newest(f)
            if last.chi2 < UNEXPLAINED * last.n or not last.rough or state.late() or self.lacks_law(last):
                break
            free = path.released(state.fitter, last, seed) if state.released < RELEASES else None
            if free is None:
                break
            state.released += 1
            state.horizons[f.key] = seed + 1
            state.keep(free)
            if abs(math.log(free.chi2 / last.chi2)) < SAME:
                state.horizons[f.key] = HORIZON_ROUNDS
                break

    def release_once(self, f: Fitted, beside: Fitted) -> None:
        """Homotopy to the free run of a nonsmooth structure, once, that is behind one ``beside`` it in a free run alone."""
        state, criterion = self.state, self.state.context.criterion
        eligible = state.options.free and state.fitter.noise.absolute and f.rough
        if not eligible or f.key in state.horizons or criterion(f) <= criterion(beside):
            return
        # where ``beside`` leaves noise alone, little is missed
        within = NEARBY * NEARBY if state.fitter.misfit(beside) > UNEXPLAINED else UNEXPLAINED
        if f.chi2 > within * beside.chi2 or state.released >= RELEASES or state.spent() or self.beaten(f, beside):
            return
        state.released += 1
        state.horizons[f.key] = 1
        free = path.released(state.fitter, f)
        if free is not None:
            state.keep(free)
            self.restart(free)

    def lacks_more(self, f: Fitted) -> bool:
        """Whether a structure lacks something else than the moments of its events, or a turn of an oscillation."""
        fitter = self.state.fitter
        # under a close observer gain the motion is nearly given, and the error is that of the torques: hardly any minima but one
        led = path.observed(fitter, f, self._close_gain(f), 20) if fitter.noise.absolute else None
        return led is not None and led.chi2 > LACKS * led.n

    def lacks_law(self, f: Fitted) -> bool:
        """Whether the residual above noise is no wrong order of events: where it is little, and stays under an observer gain.

        A model is put right within 1 / gain, so that an event at another moment costs it a fraction of what a free run pays. The
        gain is close first, where there is hardly any minimum but one.
        """
        fitter = self.state.fitter
        f = self.state.pool.newest(f)
        if not f.rough or not fitter.noise.within(f.chi2 / f.n, RESTARTED_BELOW):
            return False
        stays = f.n + STAYS * (f.chi2 - f.n)
        led = path.observed(fitter, f, LEAD, 20)
        for gain in (self._close_gain(f), BETWEEN, LEAD) if led is not None and led.chi2 > stays else ():
            led = path.observed(fitter, led or f, gain, 20)
        return led is not None and led.chi2 > stays

    def sticks(self, f: Fitted) -> bool:
        """Whether the nonsmooth effects of a structure matter to its error."""
        bare = self.state.pool.get(key_of(tuple(e for e in f.effects if not type(e).rough))) if f.rough else None
        return f.rough and (bare is None or f.chi2 < 0.9 * bare.chi2)

    def beaten(self, f: Fitted, current: Fitted) -> bool:
        """Whether a structure stays behind another one under a close observer gain too, so that no wrong minimum is to blame."""
        fitter = self.state.fitter
        if not fitter.noise.absolute:
            return False
        gain = self._close_gain(f, current)
        mine, best = fitter.map([partial(path.observed, fitter, g, gain, 20) for g in (f, current)])
        return mine is not None and best is not None and self.state.context.gain(mine, best) > self.state.options.entry

    def smooths(self, current: Fitted, f: Fitted) -> bool:
        """Whether a structure adds little to one that went over growing horizons; next to nothing if it is multimodal itself."""
        added = [type(e) for e in f.effects if e.key not in current.key]
        least = LITTLE if any(cls.multistart > 1 or cls.rough for cls in added) else RIVAL
        return current.key in self.state.horizons and set(current.key) < set(f.key) and math.log(current.chi2 / f.chi2) < least

    def _close_gain(self, *structures: Fitted) -> float:
        """The close observer gain [1/s]: that of the lightest driven body among structures."""
        nominal = self.state.fitter.nominal.chain.bodies[0].inertia
        return path.CLOSELY * min(1.0, *(f.axis.chain.bodies[0].inertia / nominal for f in structures))
