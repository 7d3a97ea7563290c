"""A tempered prior: the nominal parameters weigh more while much is missing, and all structures near are fitted again by that."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial

from diagnose.fit.fitted import Fitted
from diagnose.fit.whiten import guide_of
from diagnose.structure.continuation import Continuation
from diagnose.structure.state import State
from diagnose.thresholds import HALF, MISFIT, REFITTED_WITHIN, SHORTER, WEIGHED

__all__ = ["Tempering"]


@dataclass
class Tempering:
    """Changes the weight of the prior in a search."""

    state: State
    path: Continuation
    _untempered: Fitted | None = field(default=None, init=False)

    def tempered(self, f: Fitted, least: float = MISFIT) -> Fitted:
        """A fit from which to go on, the nominal linear parameters weighing as much as is fair beside so large a misfit.

        While physics is missing, refitted parameters stand in for it and lead away from it (an inertia three times the nominal
        one, with friction and a lag not yet there). By `guide_of` a prior counts; it goes as the misfit goes.
        """
        fitter = self.state.fitter
        if not fitter.noise.exceeds(f.chi2 / f.n, least):
            return self.weigh(1.0, f)
        weight, old = guide_of(fitter, f), fitter.prior_weight
        return self.weigh(weight, f) if old == 1.0 or weight < HALF * old else f

    def weigh(self, weight: float, current: Fitted) -> Fitted:
        """Weigh the prior by ``weight`` from now on: the structures near the current one are fitted again, others go."""
        state, pool = self.state, self.state.pool
        if weight == state.fitter.prior_weight:
            return current
        if state.fitter.prior_weight == 1.0:
            self._untempered = pool[()]
        state.context.fitter = state.fitter.relax(prior_weight=weight)
        slow = state.context.slow
        near = sorted(
            (f for f in pool.values() if f.chi2 < REFITTED_WITHIN * current.chi2 and not slow(f)), key=state.context.criterion
        )
        near = near[: 0 if state.late() else state.options.width]
        again = {f.key: f for f in (pool[()], current, *near)}
        pool.clear()
        state.tried.clear()
        state.warm.clear()
        near = [f for f in again.values() if f.key]
        fits, lengths = [partial(self._refitted, f, last=f.key == current.key) for f in near], state.fitter.lengths(near)
        if weight != 1.0:
            fits.append(partial(state.fitter.fit, state.fitter.hypothesis(())))  # from the nominal parameters
            lengths.append(math.inf)
        elif self._untempered is not None:
            state.keep(self._untempered)
        for f in state.fitter.map(fits, lengths):
            state.keep(self.path.smoothed(f) if f.key == current.key else f)
        return pool.newest(current)

    def alone(self, f: Fitted) -> Fitted:
        """A structure by its own weights, its rivals left as they are: they will be raced again, on whitened errors."""
        if self.state.fitter.prior_weight == 1.0:
            return f
        self.state.pool.drop(*[k for k in self.state.pool if k and k != f.key])
        return self.weigh(1.0, f)

    def _refitted(self, f: Fitted, *, last: bool) -> Fitted:
        """A structure under another weight of the prior: to the ``last``, or as a rival, for which a gain of one in C is enough.

        A rival's sensitivities are known, unless its cost is nonsmooth.
        """
        fitter = self.state.fitter
        if last or f.rough:
            most = SHORTER if self.state.context.slow(f) else WEIGHED
            return fitter.fit(f.hypothesis, f.fit.x, iterations=most, tolerance=1e-6 if last else 1.0 / f.n)
        fit = fitter.fit(f.hypothesis, f.fit.x, iterations=WEIGHED, tolerance=1.0 / f.n, borrow=f, secant=True, rival=True)
        return fit.to_go_on()
