"""The search on plain errors and, where noise is coloured, again on whitened ones.

Which filter is the noise's is a question of its own: a residual is coloured by its noise or by motion that the model misses.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from diagnose.data.experiment import measured_angle, measured_velocity, middle
from diagnose.data.runs import free_run
from diagnose.evidence.force_orders import force_orders
from diagnose.evidence.orders import find_orders, torque_to_velocity
from diagnose.evidence.predictable import motion_error
from diagnose.evidence.sensor_offset import excluded_by_angle
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.timing import taken_early
from diagnose.fit.validation import pooled
from diagnose.fit.whiten import (
    effective_share,
    effective_share_between,
    innovation,
    offset_share,
    same_filter,
    tempered_prior_weight,
    whitened_fit,
    whitening_filter,
)
from diagnose.options import Options
from diagnose.progress import Progress
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import candidates
from diagnose.structure.search import Search
from diagnose.thresholds import FAR, LEADING, MATERIAL, SECOND_SPLIT, TWICE
from mjsim.errors import InputError

__all__ = ["prepared", "searched"]


def _orders(fitter: Fitter, fitted: Fitted) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Spatial orders of the residual of a fitted model on its first experiment: of torques, of the arm's inertia; unsure ones."""
    experiment = fitter.experiments[0]
    r = experiment.recording
    if fitter.view.channel == "torque":
        orders, unsure = force_orders(fitter, fitted)
        return (*orders, *unsure), (), unsure
    initial = fitted.hypothesis.initial(fitted.fit.x, 0)
    e = fitter.error(fitted.axis, experiment, initial)
    if e is None:
        return (), (), ()
    find = partial(find_orders, e, dt=r.dt, keep=fitter.counted(experiment), run=fitter.map)
    angle = measured_angle(r)
    b, a = torque_to_velocity(fitted.axis, r.dt, about=middle(r), by_velocity=r.angle is None)
    orders = find(angle, measured_velocity(r), b, a)
    # a spring lets the arm swing otherwise than the motor: how, only a simulation tells
    y = free_run(fitted.axis, experiment, initial)
    arm = len(fitter.nominal.chain.bodies) - 1
    ratio = fitter.nominal.chain.total_ratio(arm)
    b, a = torque_to_velocity(fitted.axis, r.dt, arm, middle(r), by_velocity=r.angle is None)
    return orders, find(angle + y.q[:, arm] / ratio - y.q[:, 0], y.v[:, arm] / ratio, b, a, most=LEADING, inertia=True), ()


def _search(
    fitter: Fitter,
    options: Options,
    progress: Progress,
    leaves_noise_by: Callable[[Fitter, Fitted], bool] | None = None,
    known: Fitted | None = None,
) -> tuple[Search, Fitted]:
    """One search by the fitter's present weights; ``known``: a structure of an earlier one, which is a rival from the start."""
    search, _ = prepared(fitter, options, progress, leaves_noise_by, known)
    fitter, found = search.fitter, search.run()
    if fitter.late:
        search.state.late = True
        progress.stage("search", "the budget of time is used up")
    return search, found


def prepared(
    fitter: Fitter,
    options: Options,
    progress: Progress,
    leaves_noise_by: Callable[[Fitter, Fitted], bool] | None = None,
    known: Fitted | None = None,
) -> tuple[Search, Fitted]:
    """A search that has refitted the nominal model and knows its candidates, and that fit."""
    chosen = SearchOptions(only=options.effects, depth=options.depth)
    chosen = dataclasses.replace(chosen, **dataclasses.asdict(fitter.noise.prices))
    search = Search(fitter, chosen, progress=progress, leaves_noise_by=leaves_noise_by)
    base = search.nominal()
    if not base.ok:
        raise InputError(
            fitter.experiments[0].recording.source, "the nominal model diverges on this input", "a model that can be run",
            "check units, signs and the actuator's gain",
        )  # fmt: skip
    _need_same_sign(fitter, base)
    if fitter.view.channel == "angle":
        fitter = fitter.paced_by(base.axis)
        search.use(fitter)
    if known is not None and known.effects:
        search.warm_start(known)
    fitter = fitter.with_orders(*_orders(fitter, base))
    search.use(fitter)
    search.state.requires = excluded_by_angle(fitter.experiments)
    search.state.consider([c for c in candidates(fitter, options.effects) if search.state.requires.get(c.id) != ""])
    search.orders_of = _orders
    if not fitter.noise.absolute:
        search.context.effective = effective_share(fitter, base)
        search.effective_of = effective_share
        search.context.share_between = partial(effective_share_between, fitter)
    return search, base


def _need_same_sign(fitter: Fitter, base: Fitted, clear: float = 0.7) -> None:
    """Refuse a recording whose motion goes against its torque: a sign, and no physics.

    The nominal model goes the other way, and refitted it does not follow either (which it does where a resonance was shifted).
    """
    for i, experiment in enumerate(fitter.experiments):
        keep = fitter.counted(experiment)
        alike = []
        for axis in (fitter.nominal, base.hypothesis.axis(base.fit.x, i)):
            s = fitter.view.signals(axis, experiment, None)
            if s is not None and min(np.std(s.measured[keep]), np.std(s.predicted[keep])) > 0:
                alike.append(float(np.corrcoef(s.measured[keep], s.predicted[keep])[0, 1]))
        if alike and alike[0] < -clear and alike[-1] < clear:
            raise InputError(
                experiment.recording.source, f"the axis moves against its torque (correlation with the model {alike[0]:.2f})",
                "torque and motion counted in one direction", "turn the sign of one: gain = -1 in the binding",
            )  # fmt: skip


def _whitening(fitter: Fitter, search: Search, best: Fitted) -> tuple[np.ndarray, bool]:
    """The filter of the residual ([1] where it is white), and whether it is that of the best structure.

    That of the refitted nominal model unless the innovations of the best structure are significantly better.
    A structure that was found on plain errors may have taken the noise for physics, under feedback above all, and its filter then
    keeps what it took. The two are compared by the likelihood of their innovations, each with its own filter.
    """
    settled = whitened_fit(fitter, best)
    if settled is None:
        return np.ones(1), False
    if not best.effects:
        return settled[0], False
    nominal = whitened_fit(fitter, search.nominal())
    if nominal is None or search.criterion(nominal[1]) - search.criterion(settled[1]) > search.options.entry:
        return settled[0], True
    return nominal[0], False


def _whitened_from_nominal(fitter: Fitter, base: Fitted, noise_only: Callable[[Fitter, Fitted], bool]) -> Fitted | None:
    """The nominal structure settled with its own filter, where it leaves noise alone; None where it does not, or is white.

    Started where its nominal parameters hold it. What the estimation recordings leave open is asked of all recordings together.
    """
    held = fitter.relax(prior_weight=tempered_prior_weight(fitter, base)).fit(fitter.hypothesis(()))
    settled = whitened_fit(fitter, held)
    if settled is None or noise_only(fitter, settled[1]):
        return None if settled is None else settled[1]
    by_all = pooled(fitter.relax(whitening=settled[0]), settled[1])
    return settled[1] if noise_only(fitter, by_all) else None


@dataclass(frozen=True)
class _NoiseOnly:
    """Whether what a structure leaves is noise and no missed motion.

    missed: largest mean square of missed motion over that of the noise; unknown: the answer where one channel alone shows it.
    """

    missed: float
    unknown: bool = False

    def __call__(self, fitter: Fitter, f: Fitted) -> bool:
        found = motion_error(fitter, f)
        return self.unknown if found is None else found < self.missed


def _leaves_coloured_noise(fitter: Fitter, f: Fitted, missed: float) -> bool:
    """Whether a structure leaves coloured noise alone, so that nothing more is sought on plain errors.

    It must leave more colour than the motion that may be missed can give, and no offset, which is the sensor's and no motion.
    """
    if whitening_filter(fitter, f, material=2 * missed) is None or offset_share(fitter, f) >= MATERIAL / 2:
        return False
    found = motion_error(fitter, f)
    if found is None or found < missed:
        return found is not None
    fitted_to = motion_error(fitter, f, on=fitter.experiments)
    if f.effects and (fitted_to is None or fitted_to >= missed):
        return False
    surely = _NoiseOnly(missed)
    if surely(fitter, pooled(fitter, f)):  # or the excitation leaves parameters open, which noise has settled
        return True
    may_be_noise = not f.effects and fitted_to is not None and fitted_to <= TWICE**2
    return may_be_noise and _whitened_from_nominal(fitter, f, surely) is not None


def searched(fitter: Fitter, options: Options, progress: Progress) -> tuple[Search, Fitted, bool]:
    """The search on plain errors and, where these are coloured by noise, again on whitened ones; whether they were whitened.

    A residual is coloured by its noise or by motion that the model misses; only noise may be whitened away. Once the angle shows
    that a structure misses no motion, and its residual is coloured, nothing is sought beside it on plain errors: there the
    colour counts as mismatch. Under feedback a fit on plain errors takes the colour for response: the nominal structure is
    asked as it settles with its own filter, too. A structure found on whitened errors may have another filter, or none:
    then it is sought once more. A search that found nothing before its budget of time was used up is the only one.
    """
    fitter = taken_early(fitter)
    known = fitter.noise.absolute
    alone = partial(_leaves_coloured_noise, missed=options.missed) if known else None
    search, best = _search(fitter, options, progress, alone)
    if fitter.late and not best.effects:  # one that was found must still earn its filter
        return search, best, False
    search, best = _or_tied(search, best, options, progress)
    fitter = search.fitter
    noise_only = _NoiseOnly(options.missed, unknown=True)
    if not known or not (noise_only(fitter, best) or noise_only(fitter, pooled(fitter, best))):
        # or a fit on plain errors took the colour for response, where the excitation leaves parameters open
        settled = _whitened_from_nominal(fitter, search.nominal(), _NoiseOnly(options.missed)) if known else None
        if settled is None:
            return search, best, False
        best = settled
    for again in (False, True):
        spent = fitter.spent
        if spent and (again or not best.effects):  # a search that could not look would find nothing
            break
        if known and innovation(fitter, best, np.ones(1)) < 1 / TWICE:  # what is below the noise has no colour to be named
            break
        filter_, own_filter = _whitening(fitter, search, best)
        if same_filter(filter_, fitter.whitening / fitter.whitening[0]) or (spent and own_filter):
            break
        progress.stage("search", "again on whitened errors, since the residual is coloured")
        before, found = search, best
        whitened = fitter.relax(whitening=_scaled(fitter, best, filter_))
        search, best = _search(whitened, options, progress, known=best if again or own_filter else None)
        fitter = search.fitter
        search.state.tested += before.tested
        if fitter.spent and not spent and set(best.key) < set(found.key):  # it could not look at what the search before has found
            before.use(before.fitter.with_orders(fitter.orders, fitter.problem.swung, fitter.problem.unsure))
            return before, found, len(before.fitter.whitening) > 1
    return search, best, len(search.fitter.whitening) > 1


def _or_tied(search: Search, best: Fitted, options: Options, progress: Progress) -> tuple[Search, Fitted]:
    """The search, or where it leaves much the one from what is found with gravity and springs at the recorded angle, if better.

    A model whose physics is far off swings otherwise than the recording, and what it lacks is then judged about a wrong motion.
    """
    fitter = search.fitter
    if not fitter.problem.holds or not fitter.above(best, FAR):
        return search, best
    part, more = fitter.related(fitter.problem.tied()), SECOND_SPLIT * fitter.most_runs
    part.allow(more, fitter.engine.until)
    _, found = _search(part, options, progress)
    fitter.count_work(part.work)
    if not found.ok or not found.effects:
        return search, best
    fitter.allow(fitter.runs + more)
    other, again = _search(fitter, options, progress, known=found)
    if not again.ok or search.criterion(again) >= search.criterion(best):
        return search, best
    other.state.tested += search.tested
    return other, again


def _scaled(fitter: Fitter, f: Fitted, filter_: np.ndarray) -> np.ndarray:
    """A filter that leaves the residual of a structure at rms one."""
    return filter_ / innovation(fitter, f, filter_) if len(filter_) > 1 else filter_
