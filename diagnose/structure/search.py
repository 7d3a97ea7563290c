"""Search over structures: one queue of moves, each bounded by its score test, the largest bound per simulation first.

    queue = moves(nominal)
    while queue and budget:
        move = queue.pop(max(bound / cost))
        fit its neighbours by successive halving
        incumbent = best by the evidence; if it is new: queue += moves(incumbent)
    prune(incumbent)

`diagnose.structure.graph` gives the neighbours, `diagnose.structure.significance` the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import final

from diagnose.evidence.context import Context
from diagnose.fit.fits import Fits
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.path import over_horizons, relaxed
from diagnose.fit.starts import about_nominal
from diagnose.progress import Progress
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import candidates
from diagnose.structure.halving import Halving
from diagnose.structure.moves import Move, Moves
from diagnose.structure.observing import Observing
from diagnose.structure.pruning import Pruning
from diagnose.structure.selection import Selection
from diagnose.structure.significance import Significance
from diagnose.structure.state import State
from diagnose.thresholds import FAR, LEADING, SAME, SMALL, TWICE, UNEXPLAINED

__all__ = ["Search"]


@final
class Search:
    """A search by a fitter's weights.

    leaves_noise_by: whether the residual of a structure is noise alone; effective_of, orders_of: effective share of the samples,
    and spatial orders, in the residual of a structure.
    """

    def __init__(
        self,
        fitter: Fitter,
        options: SearchOptions,
        progress: Progress | None = None,
        leaves_noise_by: Callable[[Fitter, Fitted], bool] | None = None,
    ) -> None:
        self.options, self.progress, self.leaves_noise_by = options, progress or Progress(), leaves_noise_by
        self.effective_of: Callable[[Fitter, Fitted], float] | None = None
        self.orders_of: Callable[[Fitter, Fitted], tuple[tuple[float, ...], ...]] | None = None
        self.context = Context(fitter, options.prices)
        self.state = State(self.context, options, self.progress)
        self.significance = Significance(self.state)
        self.selection = Selection(self.state, self.significance)
        self.halving = Halving(self.state)
        self.observing = Observing(self.state)
        self.many_minima = False  # whether the nominal structure has another minimum that is clearly lower
        self.moves = Moves(self.state, self.halving)
        self.pruning = Pruning(self.state, self.significance)
        self.state.consider(candidates(fitter, options.only))

    @property
    def fitter(self) -> Fitter:
        """The fitter by the present weights and orders."""
        return self.context.fitter

    def use(self, fitter: Fitter) -> None:
        """Use another fitter of the same recordings from now on."""
        self.context.fitter = fitter

    @property
    def fits(self) -> Fits:
        """The best fit of each structure."""
        return self.context.fits

    @property
    def tested(self) -> int:
        """Hypotheses so far."""
        return self.state.tested

    def nominal(self) -> Fitted:
        """The refitted nominal model: the rival to beat."""
        if () not in self.fits:
            plain = self.fitter.fit(self.fitter.hypothesis(()))
            f = about_nominal(self.fitter, plain)
            if not f.ok:
                return f
            self.state.keep(f)
            self.many_minima = f is not plain
        return self.fits[()]

    def criterion(self, f: Fitted) -> float:
        """C of a structure."""
        return self.context.criterion(f)

    def held_out(self, f: Fitted) -> HeldOut | None:
        """Held-out error of a structure."""
        return self.context.held_out(f)

    def keep(self, f: Fitted) -> None:
        """Record a fit."""
        self.state.keep(f)

    def warm_start(self, f: Fitted) -> None:
        """Fit a structure that was found by other weights, from its parameters there: it is a rival whatever its score test."""
        self.keep(self.fitter.fit(self.fitter.hypothesis(f.effects, f.linear, f.own)))

    def run(self) -> Fitted:
        """The best structure that the search finds."""
        current = self.nominal()
        self._report(current)
        if self._leaves_only_noise(current):
            return current
        current = self._observed(self._with_confirmed_offset(current))
        queue = self._moves(current)
        while not self.state.spent():
            queue = [m for m in queue if self._potential(m, current) > self.context.floor(current)]
            if not queue:
                break
            move = max(queue, key=lambda m: self._potential(m, current) / m.cost)
            queue.remove(move)
            self.progress.stage("search", f"{move.name} {' + '.join(move.base.key) or 'the nominal model'}")
            self.halving.run(move.base, move.neighbours, move.floor)
            best = self._relaxed(current, self.selection.best(current))
            if best.key == current.key and best.chi2 > (1.0 - SMALL * SAME) * current.chi2:
                continue
            changed = best.key != current.key
            current = best
            if changed:
                current = self._observed(current)
                self._advance(current)
                if self._leaves_only_noise(current):
                    return current
            queue += self._moves(current)
        return self._pruned(current)

    def expand(self, base: Fitted) -> list[Fitted]:
        """Fit the structures with one effect more than ``base`` that the score test does not rule out."""
        added = self.moves.add(base)
        return [] if added is None else self.halving.run(base, added.neighbours, added.floor)

    def _potential(self, move: Move, current: Fitted) -> float:
        """How far C may fall below that of the incumbent by a move: its bound less what its base is behind.

        Nothing where the incumbent leaves noise alone, but for its own moves.
        """
        if move.base.key == current.key:
            return move.bound
        return 0.0 if self.context.leaves_noise(current) else move.bound - self.context.ahead(current, move.base)

    def _moves(self, current: Fitted) -> list[Move]:
        """The moves from the incumbent."""
        grown = self.moves.add(current) if len(current.effects) < self.options.depth else None
        return [m for m in (grown, *self.moves.replace(current)) if m is not None]

    def _relaxed(self, current: Fitted, best: Fitted) -> Fitted:
        """The best structure once those near it were fitted along falling observer gains, where they are nonsmooth or leave much.

        Such a fit may have ended in one of many minima, and which structure is ahead is chance until then.
        """
        if not self.fitter.noise.absolute or self.fitter.view.channel != "velocity":
            return best
        near = [f for f in self.fits.values() if len(f.effects) == len(best.effects) and f.chi2 < TWICE * best.chi2]
        near = [f for f in near if f.rough or self.fitter.above(f, FAR)]
        near = sorted(near, key=self.criterion)[:LEADING]
        near = [f for f in near if self.state.once("relax", f.key, round(math.log(f.chi2), 1)) and not self.state.spent()]
        for f in self.fitter.map([partial(relaxed, self.fitter, f) for f in near]):
            self.state.keep(f)
        horizons = self._over_horizons(self.selection.best(self.fits.best(current)) if near else best)
        return self.selection.best(self.fits.best(current)) if near or horizons else best

    def _over_horizons(self, best: Fitted) -> bool:
        """Fit the leading nonsmooth structure over growing horizons and then along falling gains, where the best leaves much.

        An early event at the wrong time moves all later ones, which the falling gains alone do not undo.
        """
        if not self.fitter.above(best, FAR) or self.state.spent():
            return False
        ahead = [f for f in self.fits.values() if f.rough and f.ok and self.criterion(f) <= self.criterion(best)]
        leading = min(ahead, key=self.criterion, default=None)
        if leading is None or not self.state.once("horizons", leading.key, round(math.log(leading.chi2), 1)):
            return False
        found = over_horizons(self.fitter, leading, leading.linear)
        if not found.ok or found is leading:
            return False
        self.state.keep(relaxed(self.fitter, found))
        return True

    def _observed(self, current: Fitted) -> Fitted:
        """The best structure once additions were compared under an observer gain, where the free run has many minima."""
        while self.many_minima and self.fitter.above(current, FAR) and len(current.effects) < self.options.depth:
            if not self.state.once("observe", current.key, round(math.log(current.chi2), 1)) or not self.observing.run(current):
                break
            best = self.selection.best(current)
            if best.key == current.key:
                break
            current = best
        return self.fits.best(current)

    def _advance(self, current: Fitted) -> None:
        """Take the effective share of the samples and the spatial orders from the residual of a new incumbent."""
        if self.effective_of is not None:
            self.context.effective = self.effective_of(self.fitter, current)
        if self.orders_of is not None and current.chi2 > UNEXPLAINED * current.n:
            self.use(self.fitter.with_orders(*self.orders_of(self.fitter, current)))
        self._report(current)

    def _with_confirmed_offset(self, current: Fitted) -> Fitted:
        """The structure with the effects that the angle confirms whatever the model is, where they are significant."""
        for candidate in [c for c in self.state.candidates if c.id in self.state.requires.values()]:
            neighbours = self.halving.screening(current).screen([candidate])
            self.state.tested += len(neighbours)
            for larger in self.halving.run(current, [(current.effects, s) for s in neighbours], -math.inf):
                if self.significance.significant(current, larger):
                    current = larger
        return current

    def _leaves_only_noise(self, f: Fitted) -> bool:
        """Whether the residual of a structure is noise alone, so that more is sought on whitened errors only."""
        return self.leaves_noise_by is not None and self.leaves_noise_by(self.fitter, f)

    def _pruned(self, current: Fitted) -> Fitted:
        """Without effects that are not significant; what remains is refined again beside what was dropped."""
        for _ in range(self.options.depth):
            kept = self.pruning.eliminate(current)
            if kept.key == current.key or self.state.spent():
                return kept
            for move in filter(None, self.moves.replace(kept)):
                self.halving.run(move.base, move.neighbours, move.floor)
            current = self.selection.best(kept)
        return self.pruning.eliminate(current)

    def polish(self, fitted: Fitted) -> Fitted:
        """The same structure fitted to a tight tolerance; to a loose one where other physics is missing.

        As it is where the budget is spent and the residual is far from the noise.
        """
        if self.fitter.spent and self.fitter.above(fitted, FAR):
            return fitted
        better = self.fitter.fit(
            fitted.hypothesis, fitted.fit.x, iterations=12 if fitted.rough else 40, tolerance=1e-6 if fitted.rough else 1e-8,
            slow=(self.fitter.noise.cost_at(FAR, fitted.n), SMALL * SAME),
        )  # fmt: skip
        if better.ok and better.chi2 <= fitted.chi2:
            self.keep(better)
            return better
        return fitted

    def _report(self, current: Fitted) -> None:
        """Report the best so far, by its error against that of the refitted nominal model."""
        if not current.key:
            self.progress.best("the nominal model, refitted")
            return
        share = 100 * math.sqrt(current.chi2 / current.n / (self.nominal().chi2 / self.nominal().n))
        self.progress.best(f"{' + '.join(current.key)} ({share:.3g} % of the refitted nominal's error)")
