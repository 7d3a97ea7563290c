"""Friction of each recording by itself, the rest of the best structure held, and its trend over time.

Of the structure that all recordings together gave, the sizes of friction are fitted to one recording after the other:

    min over p_r of  |r_r(p_r, theta)|^2,    theta: everything else, as all recordings together have it

with p_r the viscous coefficients and the sizes of the friction effects, beside the numbers that belong to the recording (the
speed at which it starts, phases). Stretches of a long recording show by it how friction changes as a machine warms up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.data.experiment import Experiment
from diagnose.evidence.intervals import half_width, sizes_of
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.problem.hypothesis import Entry
from diagnose.result import Estimate
from diagnose.thresholds import ALPHA
from diagnose.verdict.decide import estimates

__all__ = ["Trend", "friction_by_recording", "trends"]

FAMILIES = ("friction", "speed")


def friction_by_recording(fitter: Fitter, best: Fitted) -> dict[str, dict[str, Estimate]]:
    """Sizes of friction with 95 % intervals, by the hash of a recording (fitted or held out) and the name of the number.

    A recording of which the fit does not run is left out.
    """
    found: dict[str, dict[str, Estimate]] = {}
    for experiment in (*fitter.experiments, *fitter.held_out):
        numbers = _of_one(fitter, best, experiment)
        if numbers:
            found[experiment.recording.sha256] = numbers
    return found


def _of_one(fitter: Fitter, best: Fitted, experiment: Experiment) -> dict[str, Estimate]:
    alone = Fitter.of(fitter.problem.on((experiment,), (experiment,)), fitter.engine.related())
    laid_out = alone.hypothesis(best.effects, best.linear)
    free = tuple(e for e in laid_out.entries if e.recording == 0 or _is_friction(e, best))
    if all(e.recording == 0 for e in free):
        return {}
    rest = dataclasses.replace(best.axis, effects=best.carried)
    fitted = alone.fit(dataclasses.replace(laid_out, nominal=rest, entries=free))
    if not fitted.ok:
        return {}
    owners = dict.fromkeys(e.owner for e in free if e.recording < 0)
    return {
        f"{owner}.{name}" if owner else name: estimate
        for owner in owners
        for name, estimate in estimates(fitted, alone, owner).items()
        if any((e.owner, e.name) == (owner, name) and e.recording < 0 for e in free)
    }


def _is_friction(entry: Entry, best: Fitted) -> bool:
    """Whether a number is a viscous coefficient or a size of a friction effect."""
    if entry.owner == "":
        return any(p.name == entry.name and p.kind == "viscous" for p in best.axis.chain.linear_parameters())
    effect = next(e for e in (*best.carried, *best.effects) if e.key == entry.owner)
    return type(effect).family in FAMILIES and entry.name in sizes_of(effect)


@dataclass(frozen=True)
class Trend:
    """The straight line through the estimates of one number over the times [s], or temperatures [degC], of the recordings.

    slope, ci95: change per second or degree and its 95 % interval; first, last: the line at the least and the largest time or
    temperature, which are ``ends``; p_value: two-sided, of no change.
    """

    name: str
    unit: str
    slope: float
    ci95: tuple[float, float]
    first: float
    last: float
    p_value: float
    significant: bool
    ends: tuple[float, float] = (0.0, 0.0)

    def by_temperature(self) -> str:
        """Of a line over temperatures, for the notes of a diagnosis."""
        low, high = self.ci95
        cold, hot = self.ends
        return (
            f"{self.name} changes with the temperature: {self.first:.4g} {self.unit} at {cold:.3g} degC, {self.last:.4g} "
            f"{self.unit} at {hot:.3g} degC, {self.slope:.3g} {self.unit} per degree (95 % interval {low:.3g} to {high:.3g})."
        )

    def sentence(self) -> str:
        """For the notes of a diagnosis."""
        low, high = (x * 3600 for x in self.ci95)
        return (
            f"{self.name} changes over the recording: {self.first:.4g} {self.unit} at its start, {self.last:.4g} {self.unit} at "
            f"its end, {self.slope * 3600:.3g} {self.unit} an hour (95 % interval {low:.3g} to {high:.3g})."
        )


def trends(times: Sequence[float], numbers: Sequence[Mapping[str, Estimate]], fewest: int = 4) -> tuple[Trend, ...]:
    """Weighted lines y = a + b t of each number that at least ``fewest`` recordings have, weights 1 / s_i^2.

    The standard error of b is scaled by the scatter about the line where that exceeds the intervals (Birge ratio; R. T. Birge,
    Phys. Rev. 40 (1932) 207), with Student's distribution of n - 2 degrees of freedom.
    """
    lines = []
    for name in dict.fromkeys(n for each in numbers for n in each):
        rows = [(t, each[name]) for t, each in zip(times, numbers, strict=True) if name in each]
        line = _line(name, rows, fewest)
        if line is not None:
            lines.append(line)
    return _by_holm(lines)


def _line(name: str, rows: Sequence[tuple[float, Estimate]], fewest: int) -> Trend | None:
    from scipy.stats import t as student

    rows = [(at, e) for at, e in rows if np.isfinite(e.ci95).all() and e.ci95[1] > e.ci95[0]]
    if min(len(rows), len({at for at, _ in rows})) < fewest:
        return None
    at = np.array([t for t, _ in rows])
    y = np.array([e.value for _, e in rows])
    s = np.array([(e.ci95[1] - e.ci95[0]) / (2 * half_width(1.0)) for _, e in rows])
    w = 1 / s**2
    middle = float(w @ at / w.sum())
    spread = float(w @ (at - middle) ** 2)
    slope = float(w @ ((at - middle) * y)) / spread
    level = float(w @ y / w.sum())
    rest = (y - level - slope * (at - middle)) / s
    error = np.sqrt(max(1.0, float(rest @ rest) / (len(y) - 2)) / spread)
    half = float(student.ppf(0.975, len(y) - 2)) * error
    p = 2 * float(student.sf(abs(slope) / error, len(y) - 2))
    first, last = (level + slope * (end - middle) for end in (at.min(), at.max()))
    ends = float(at.min()), float(at.max())
    return Trend(name, rows[0][1].unit, slope, (slope - half, slope + half), float(first), float(last), p, False, ends)


def _by_holm(lines: Sequence[Trend]) -> tuple[Trend, ...]:
    """The same with what is significant of all of them together."""
    order = sorted(lines, key=lambda line: line.p_value)
    significant: set[str] = set()
    for place, line in enumerate(order):
        if line.p_value > ALPHA / (len(order) - place):
            break
        significant.add(line.name)
    return tuple(dataclasses.replace(line, significant=line.name in significant) for line in lines)
