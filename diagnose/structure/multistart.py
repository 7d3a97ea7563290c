"""Further starts of structures: where their parameters have gone far from the nominal ones, and at the limits of a law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from diagnose.fit.fitted import Fitted, key_of
from diagnose.fit.starts import best_of_starts, restarted
from diagnose.problem.hypothesis import make
from diagnose.structure.candidates import Screened
from diagnose.structure.continuation import Continuation
from diagnose.structure.moves import at_limits, simpler_at
from diagnose.structure.state import State
from diagnose.thresholds import ABOUT, BETTER, GONE, LONG, MISFIT, MORE, PROMISED, STARTS, UNEXPLAINED
from mjsim.effects import Effect, effect_class

__all__ = ["Multistart"]


@dataclass
class Multistart:
    """Fits structures of a search from further starts."""

    state: State
    path: Continuation

    def nominal(self) -> Fitted:
        """The refitted nominal model: the rival to beat."""
        known = self.state.pool.get(())
        if known is None:
            known = self._about_nominal(self.state.fitter.fit(self.state.fitter.hypothesis(())))
            self.state.pool.put(known)
        return known

    def _about_nominal(self, f: Fitted) -> Fitted:
        """The nominal structure from starts about its nominal parameters as well, where it leaves much.

        An effect that only leads out of a wrong minimum is no missing physics.
        """
        fitter = self.state.fitter
        if not f.ok or not fitter.above(f, MISFIT):
            return f
        rng = np.random.default_rng(0)
        nominal = {p.name: p.value for p in fitter.nominal.chain.linear_parameters()}
        factors = np.exp(ABOUT * rng.standard_normal((STARTS, len(nominal))))
        starts = [dict(zip(nominal, list(nominal.values()) * row, strict=True)) for row in factors]
        begin = [partial(fitter.fit, fitter.hypothesis((), s), iterations=8, rival=True) for s in starts]
        fits = [g for g in fitter.map(begin) if g.ok]
        best = min(fits, key=lambda g: g.chi2, default=f)
        best = fitter.fit(best.hypothesis, best.fit.x) if best is not f else f
        return best if best.ok and best.chi2 < BETTER * f.chi2 else f

    def from_nominal(self, base: Fitted, grown: Sequence[Fitted], families: Sequence[str]) -> None:
        """Start what is new in some structures at the nominal parameters, where the base's have gone far from these.

        They stand in for a further body so well that its first iterations from the nominal ones, which lead to it, are no rival.
        """
        fitter = self.state.fitter
        nominal = {p.name: p.value for p in fitter.nominal.chain.linear_parameters()}
        ratios = [base.linear[name] / value for name, value in nominal.items() if value and name in base.linear]
        gone = any(r <= 0.0 or abs(math.log(r)) > GONE for r in ratios)
        if not gone or not fitter.above(base, UNEXPLAINED):
            return
        for f in grown:
            new = [e for e in f.effects if e.key not in base.key and type(e).family in families]
            if new and f.chi2 > UNEXPLAINED * f.n and not self.state.late():
                self.state.keep(restarted(fitter, f, new, (None,)))

    def short_of_promise(self, base: Fitted, s: Screened) -> Fitted | None:
        """The rival that the screen has first, from the nominal parameters, where it stayed far short of its score-test gain.

        The first iterations of a race tell little where the base's parameters have gone to stand in for it: what stiffens much is
        another spring. None where it did not stay short, or comes to no more.
        """
        fitter, cls = self.state.fitter, effect_class(s.candidate.id)
        known = self.state.pool.get(tuple(sorted([*base.key, s.candidate.key])))
        left = max(base.chi2 - s.gain, 0.01 * base.chi2)
        promised = PROMISED * base.n * math.log(base.chi2 / left)
        if cls.rough or known is None or self.state.context.gain(base, known) > promised:
            return None
        values = cls.starts(fitter.scales_for(cls, s.candidate.place))
        starts = [*(make(cls.id, s.candidate.place, v) for v in values[:MORE]), s.effect]
        begun = [fitter.hypothesis((*base.effects, e)) for e in starts]
        best = best_of_starts(fitter, begun, len(begun), 1e-6)
        best = fitter.by_secants(best.hypothesis, best.fit.x)
        if not best.ok or best.chi2 >= known.chi2:
            return None
        self.state.keep(best)
        return best

    def limits(self, base: Fitted) -> list[Fitted]:
        """What the effects of a structure come to at an edge of their numbers, fitted from those numbers; the pool keeps it.

        A law of more numbers that stands there is the one of fewer, which may have ended in another minimum by itself. So may the
        law that one which is slow to run refines: stiff bristles hardly give, and all that follows would wait for their runs.
        """
        state, criterion = self.state, self.state.context.criterion
        out, offered = [], {c.key for c in state.candidates}
        begin = partial(state.fitter.hypothesis, linear=base.linear, own=base.own)
        quick = [
            effects for effects in (simpler_at(base) if state.context.slow(base) else ())
            if state.fitter.length(h := begin(effects), h.start) <= LONG
        ]  # fmt: skip
        for effects in [*at_limits(base), *quick]:
            mark = (base.key, (*key_of(effects), repr(base.chi2)))
            if not {e.key for e in effects} - {e.key for e in base.effects} <= offered or mark in state.tried or state.late():
                continue
            state.tried.add(mark)
            *others, limit = effects
            begun = self._about_limit(tuple(others), limit, base)
            state.keep(begun)
            if begun.ok and criterion(begun) > criterion(base):  # an event a sample later is another minimum
                self.path.land(begun)
                self.path.release_once(state.pool.newest(begun), base)
            out.append(state.pool.newest(begun))
        return out

    def _about_limit(self, others: tuple[Effect, ...], effect: Effect, base: Fitted) -> Fitted:
        """A structure from the numbers of another, and from the effect's other starts too, but for its size."""
        fitter, cls = self.state.fitter, type(effect)
        starts = cls.starts(fitter.scales_for(cls, effect.place)) if cls.multistart > 1 else []
        moved = [effect.with_values({k: x for k, x in v.items() if k not in cls.amplitudes}) for v in starts]
        begun = [fitter.hypothesis((*others, e), base.linear, base.own) for e in (effect, *moved)]
        best = best_of_starts(fitter, begun, cls.multistart)
        return fitter.fit(best.hypothesis, best.fit.x, iterations=20, rival=True)
