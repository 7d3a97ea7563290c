"""Candidates compared under an observer gain, where free runs have many minima.

Where the base is in a wrong minimum of its free run, score tests about it tell nothing. Under the gain the measured velocity
keeps the model near the recording, so that fits from the nominal parameters converge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.path import observed
from diagnose.problem.hypothesis import make
from diagnose.problem.view import highest_observer_gain
from diagnose.structure.candidates import Candidate
from diagnose.structure.graph import additions
from diagnose.structure.state import State
from diagnose.thresholds import LEADING, OBSERVER_GAINS
from mjsim.effects import effect_class

__all__ = ["Observing"]


@dataclass
class Observing:
    """Ranks additions to a structure under the highest observer gain and fits the best of them along falling gains."""

    state: State

    def run(self, base: Fitted) -> list[Fitted]:
        """The best additions, fitted to the free run and recorded; none where the judged channel is not a velocity."""
        fitter = self.state.fitter
        gains = sorted(g for g in OBSERVER_GAINS if g <= highest_observer_gain(base.axis))[:2]
        if fitter.view.channel != "velocity" or not gains or self.state.spent():
            return []
        present = [e.id for e in base.effects]
        offered = [c for c in additions(self.state.candidates, base, laws=False) if self.state.admitted([c.id, *present])]
        self.state.tested += len(offered)
        ranked = [f for f in fitter.map([partial(_observed, fitter, base, c, gains[-1]) for c in offered]) if f is not None]
        ranked.sort(key=self.state.context.criterion)
        out = fitter.map([partial(_freed, fitter, f, gains[::-1]) for f in ranked[:LEADING]])
        for f in out:
            self.state.keep(f)
        return out


def _observed(fitter: Fitter, base: Fitted, candidate: Candidate, gain: float) -> Fitted | None:
    """A structure with one effect more after few iterations under an observer gain; None where it cannot be run."""
    cls = effect_class(candidate.id)
    linear = base.linear if base.effects else {p.name: p.value for p in fitter.nominal.chain.linear_parameters()}
    effect = make(cls.id, candidate.place, cls.starts(fitter.scales_for(cls, candidate.place))[0])
    start = fitter.fit(fitter.hypothesis((*base.effects, effect), linear), iterations=0)
    return observed(fitter, start, gain, 3) if math.isfinite(start.chi2) else None


def _freed(fitter: Fitter, f: Fitted, gains: Sequence[float]) -> Fitted:
    """A structure fitted along falling gains, and then to the free run."""
    for gain in gains:
        f = observed(fitter, f, gain) or f
    return fitter.fit(f.hypothesis, f.fit.x, iterations=20)
