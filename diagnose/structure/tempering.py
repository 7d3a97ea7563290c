"""Nominal parameters that guide a search while much is missing: every structure is fitted again as their weight changes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

from diagnose.fit.fitted import Fitted
from diagnose.fit.whiten import guide_of
from diagnose.structure.multistart import MISFIT, Minima

__all__ = ["Guided"]

WEIGHED, SHORTER = 12, 4  # iterations of the best structure under another weight of the prior, and of one that is slow to run


@dataclass
class Guided(Minima):
    """Everything fitted so far, by one weight of the nominal parameters."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._unguided: Fitted | None = None

    def _guided(self, f: Fitted, least: float = MISFIT) -> Fitted:
        """A fit from which to go on, the nominal linear parameters weighing as much as is fair beside so large a misfit.

        While physics is missing, refitted parameters stand in for it and lead away from it (an inertia three times the nominal
        one, with friction and a lag not yet there). By `guide_of` a prior counts; it goes as the misfit goes.
        """
        misfit = f.chi2 / f.n
        if not self.fitter.noise.exceeds(misfit, least):
            return self._weigh(1.0, f)
        weight, old = guide_of(self.fitter, f), self.fitter.guide
        return self._weigh(weight, f) if old == 1.0 or weight < 0.5 * old else f

    def _weigh(self, guide: float, current: Fitted) -> Fitted:
        """Weigh the prior by ``guide`` from now on: the structures that are near the current one are fitted again, others go."""
        if guide == self.fitter.guide:
            return current
        if self.fitter.guide == 1.0:
            self._unguided = self.pool[()]
        self.fitter.guide = guide
        near = sorted((f for f in self.pool.values() if f.chi2 < 3.0 * current.chi2 and not self._slow(f)), key=self.criterion)
        near = near[: 0 if self._late() else self.options.width]
        again = {f.key: f for f in (self.pool[()], current, *near)}
        self.pool.clear()
        self.held.clear()
        self.retried.clear()
        self._without.clear()
        near = [f for f in again.values() if f.key]
        fits, lengths = [partial(self._weighed, f, last=f.key == current.key) for f in near], self.fitter.lengths(near)
        if guide != 1.0:
            fits.append(partial(self.fitter.fit, self.fitter.hypothesis(())))  # from the nominal parameters
            lengths.append(math.inf)
        elif self._unguided is not None:
            self.keep(self._unguided)
        for f in self.fitter.map(fits, lengths):
            self.keep(self._smoothed(f) if f.key == current.key else f)
        return self.pool.get(current.key, current)

    def _weighed(self, f: Fitted, *, last: bool) -> Fitted:
        """A structure under another weight of the prior: to the ``last``, or as a rival, for which a gain of one in C is enough.

        A rival's sensitivities are known, unless its cost is rough.
        """
        if last or f.rough:
            most = SHORTER if self._slow(f) else WEIGHED
            return self.fitter.fit(f.hypothesis, f.fit.x, iterations=most, tolerance=1e-6 if last else 1.0 / f.n)
        fit = self.fitter.fit(f.hypothesis, f.fit.x, iterations=WEIGHED, tolerance=1.0 / f.n, borrow=f, secant=True, rival=True)
        return fit.to_go_on()
