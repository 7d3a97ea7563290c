"""Errors of the models, the ranking of the rivals, and the signals for the pictures."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial

import numpy as np

from diagnose.explain.ahead import k_step
from diagnose.fit.fitted import Fitted, HeldOut
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit
from diagnose.fit.whiten import noise_rms
from diagnose.result import FitFigures, Rival, Traces
from diagnose.structure.search import Search
from diagnose.thresholds import HALVINGS
from mjsim.axis import Axis
from mjsim.recording import Recording

__all__ = ["error_figures", "figures", "rivals", "traces"]


def error_figures(fitter: Fitter, axis_of: Callable[[int], Axis], fitted: Fitted | None, held: HeldOut | None) -> FitFigures:
    """Errors of a model: ``axis_of`` gives its axis on each estimation recording, ``held`` its held-out error."""
    squares, spread, count = 0.0, 0.0, 0
    for i, experiment in enumerate(fitter.experiments):
        initial = None if fitted is None else fitted.hypothesis.initial(fitted.fit.x, i)
        s = fitter.view.signals(axis_of(i), experiment, initial)
        if s is None:
            return FitFigures(math.nan, math.nan, math.nan, math.nan)
        keep = fitter.counted(experiment)
        m = s.measured[keep]
        squares += float(np.sum((s.measured - s.predicted)[keep] ** 2))
        spread += float(np.sum((m - m.mean()) ** 2))
        count += int(keep.sum())
    rms = math.sqrt(squares / count)
    held_rms, held_nrmse = (held.rms, held.nrmse) if held else (math.nan, math.nan)
    ahead = k_step(fitter, fitted) if fitted is not None and held is not None else ()
    return FitFigures(rms, math.sqrt(squares / spread), held_rms, held_nrmse, ahead)


def figures(fitter: Fitter, search: Search, base: Fitted, best: Fitted) -> tuple[dict[str, FitFigures], float]:
    """Errors of the nominal model as given, refitted and corrected; and the share of the held-out gap that is closed."""
    as_given = Fitted(base.hypothesis, _at(base, fitter.hypothesis(()).start), base.n)

    def of(f: Fitted) -> FitFigures:
        return error_figures(fitter, lambda i: f.hypothesis.axis(f.fit.x, i), f, search.held_out(f))

    def given() -> FitFigures:
        return error_figures(fitter, lambda _: fitter.nominal, None, fitter.validate(as_given))

    names = ("nominal", "refitted", "corrected")
    tasks = (given, partial(of, base), partial(of, best))
    fits = dict(zip(names, fitter.map(tasks), strict=True))
    before, after = fits["refitted"].held_out_rms, fits["corrected"].held_out_rms
    floor = fitter.noise.floor(float(np.mean([noise_rms(fitter, e) for e in fitter.held_out])), 0.0)
    gap = (before - after) / (before - floor) if before > floor * 1.0001 else math.nan
    return fits, gap if best.effects else math.nan


def _at(fitted: Fitted, x: np.ndarray) -> Fit:
    return dataclasses.replace(fitted.fit, x=x)


def rivals(search: Search, best: Fitted, most: int = 25) -> tuple[Rival, ...]:
    """The structures of the lowest criterion, best first."""
    reference = search.criterion(best)
    out: list[Rival] = []
    ranked = sorted(search.fits.values(), key=search.criterion)[:most]
    lengths = [n * (10.0 if i < HALVINGS[0][0] else 1.0) for i, n in enumerate(search.fitter.lengths(ranked))]

    def figures(f: Fitted, judged: bool) -> tuple[HeldOut | None, float]:
        return search.held_out(f) if judged else search.fits.known_held_out(f), _rms(search.fitter, f)

    told = search.fitter.map([partial(figures, f, i < HALVINGS[0][0]) for i, f in enumerate(ranked)], lengths)
    for f, (held, rms) in zip(ranked, told, strict=True):
        out.append(
            Rival(f.key, len(f.hypothesis.entries), rms, held.rms if held else math.nan,
                  search.criterion(f) - reference, f.fit.status.name.lower())
        )  # fmt: skip
    return tuple(out)


def _rms(fitter: Fitter, fitted: Fitted) -> float:
    """Estimation error in the view's unit, without whitening."""
    return error_figures(fitter, lambda i: fitted.hypothesis.axis(fitted.fit.x, i), fitted, None).rms


def traces(fitter: Fitter, base: Fitted, best: Fitted, mapped: Fitted | None = None) -> tuple[Traces, ...]:
    """Signals of every recording: measured, and predicted by each model."""
    out = []
    for role, group in (("estimation", fitter.experiments), ("held-out", fitter.held_out)):
        for i, experiment in enumerate(group):
            runs: list[tuple[Axis, np.ndarray | None]] = [(fitter.nominal, None)]
            for f in (base, best, *([] if mapped is None else [mapped])):
                if role == "estimation":
                    runs.append((f.hypothesis.axis(f.fit.x, i), f.hypothesis.initial(f.fit.x, i)))
                else:
                    runs.append(fitter.own_values(f.hypothesis, f, experiment) or (f.axis, None))
            signals = fitter.map([partial(fitter.view.signals, axis, experiment, initial) for axis, initial in runs])
            given, refitted, corrected, *more = signals
            if refitted is None or corrected is None:
                continue
            out.append(
                Traces(experiment.recording.source, role, refitted.time, refitted.measured, given.predicted if given else None,
                       refitted.predicted, corrected.predicted, fitter.counted(experiment),
                       fitter.noise.floor(noise_rms(fitter, experiment)),
                       more[0].predicted if more and more[0] else None,
                       _recorded(experiment.recording, fitter.view.decimate))
            )  # fmt: skip
    return tuple(out)


def _recorded(r: Recording, every: int) -> dict[str, tuple[np.ndarray, str]]:
    """The recorded channels on the view's grid: name -> (values (M,), unit)."""
    channels = {"angle": r.angle, "velocity": r.velocity, "command": r.command, "torque": r.torque if r.driven else None}
    known = {name: y for name, y in channels.items() if y is not None and np.all(np.isfinite(y))}
    return {name: (y[::every], r.units.get(name, "")) for name, y in known.items()}
