"""Compare two sets of answers case by case: what was gained and lost, what moved, what it costs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from lab.panel.record import Finding, Record
from mjsim.errors import InputError

__all__ = ["LEVEL", "Change", "Comparison", "Moved", "Pair", "compare", "markdown", "mcnemar"]

LEVEL = 0.05  # of McNemar's test, and the share of values that the 95 % intervals leave out


def mcnemar(gained: int, lost: int) -> float:
    """Two-sided p-value of McNemar's exact test.

    Under the hypothesis that both are right equally often, each of the n = gained + lost cases on which they differ falls on
    either side with probability 1/2: ``lost`` is binomial (n, 1/2). 1 where n = 0. (McNemar 1947; Fagerland et al. 2013.)
    """
    n = gained + lost
    return float(binomtest(lost, n, 0.5).pvalue) if n else 1.0


@dataclass(frozen=True)
class Change:
    """A case whose answer differs; ``kind``: gained, lost, or changed where neither is right, both are, or no truth is known."""

    case: str
    kind: str
    before: str
    after: str


@dataclass(frozen=True)
class Moved:
    """A parameter of an effect that both name whose value after is outside the 95 % interval before.

    ``explained``: neither answer is ``unexplained``, whose values are not the parameters of a model that fits.
    """

    case: str
    parameter: str
    before: float
    low: float
    high: float
    after: float
    explained: bool


@dataclass(frozen=True)
class Pair:
    """One figure before and after; NaN where there is none."""

    before: float
    after: float


@dataclass(frozen=True)
class Comparison:
    """Two sets of answers on the cases that both have.

    ``cases``: of the same files on both sides; ``unpaired``: names of cases whose files differ or that one side alone has;
    ``known``: cases with a truth; ``right``, ``false_alarms``: counts; ``p_value``: McNemar, see `mcnemar`; ``held_out_ratio``:
    of the corrected model's held-out error, after over before: median, 95th percentile, largest; ``simulations_median``,
    ``simulations_95``: of one diagnosis; ``parameter_error``: median relative error; ``coverage``: share of the 95 % intervals
    that hold the truth; ``cpu_seconds``: of all cases together.
    """

    cases: int
    unpaired: tuple[str, ...]
    known: int
    right: Pair
    gained: int
    lost: int
    p_value: float
    false_alarms: Pair
    simulations_median: Pair
    simulations_95: Pair
    parameter_error: Pair
    coverage: Pair
    cpu_seconds: Pair
    held_out_ratio: tuple[float, float, float]
    changes: tuple[Change, ...]
    moved: tuple[Moved, ...]
    common_parameters: int
    explained_parameters: int

    @property
    def parameters_differ(self) -> bool:
        """More parameters of explained answers outside their intervals than intervals of 95 % leave out."""
        return sum(m.explained for m in self.moved) > LEVEL * self.explained_parameters

    @property
    def significant_loss(self) -> bool:
        """More answers lost than gained, and by more than chance at `LEVEL`."""
        return self.lost > self.gained and self.p_value <= LEVEL

    @property
    def fails(self) -> bool:
        """A significant loss, or more false alarms."""
        return self.significant_loss or self.false_alarms.after > self.false_alarms.before

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "significant_loss": self.significant_loss, "fails": self.fails, "level": LEVEL}


def _said(r: Record) -> str:
    if r.error:
        return f"error: {r.error}"
    return f"{r.verdict}: {', '.join(r.named)}" if r.named else r.verdict


def _changes(pairs: Sequence[tuple[Record, Record]]) -> Iterator[Change]:
    for a, b in pairs:
        if a.good == b.good and (a.verdict, a.named) == (b.verdict, b.named):
            continue
        kind = "changed" if a.good == b.good or a.good is None else "gained" if b.good else "lost"
        yield Change(a.case, kind, _said(a), _said(b))


def _common(a: Record, b: Record) -> Iterator[tuple[str, tuple[float | None, ...], tuple[float | None, ...]]]:
    """(name, estimate before, estimate after) of each parameter that both have; those of the model only where the names agree."""
    after: Mapping[str, Finding] = {f.key: f for f in b.findings}
    for f in a.findings:
        if f.key in after:
            other = after[f.key].parameters
            yield from ((f"{f.key}.{n}", p, other[n]) for n, p in f.parameters.items() if n in other)
    if a.named == b.named and not a.error and not b.error:
        yield from ((n, p, b.linear[n]) for n, p in a.linear.items() if n in b.linear)


def _moved(pairs: Sequence[tuple[Record, Record]]) -> tuple[list[Moved], int, int]:
    """Those beyond the interval, how many had one, and how many of these belong to explained answers."""
    out, count, claimed = [], 0, 0
    for a, b in pairs:
        explained = "unexplained" not in (a.verdict, b.verdict)
        for name, (value, low, high), (after, _, _) in _common(a, b):
            if value is None or low is None or high is None or after is None:
                continue
            count += 1
            claimed += explained
            if not low <= after <= high:
                out.append(Moved(a.case, name, value, low, high, after, explained))
    return out, count, claimed


def _pair(function: Any, pairs: Sequence[tuple[Any, Any]]) -> Pair:
    """A statistic of both sides; NaN of nothing."""
    if not pairs:
        return Pair(float("nan"), float("nan"))
    return Pair(*(float(function(side)) for side in zip(*pairs, strict=True)))


def _median_error(records: Sequence[Record]) -> float:
    errors = [e for r in records for e in r.errors]
    return float(np.median(errors)) if errors else float("nan")


def _coverage(records: Sequence[Record]) -> float:
    inside, count = (sum(r.inside[k] for r in records) for k in (0, 1))
    return inside / count if count else float("nan")


def _ratio(pairs: Sequence[tuple[Record, Record]]) -> tuple[float, float, float]:
    held = [(a.held_out[-1], b.held_out[-1]) for a, b in pairs if a.held_out and b.held_out]
    ratios = [y / x for x, y in held if x and y]
    if not ratios:
        return (float("nan"),) * 3
    return float(np.median(ratios)), float(np.quantile(ratios, 0.95)), float(max(ratios))


def compare(before: Mapping[str, Record], after: Mapping[str, Record]) -> Comparison:
    """Pair the answers by case. Raises InputError where no case has the same files on both sides."""
    names = sorted(k for k in before if k in after and before[k].hash == after[k].hash)
    if not names:
        raise InputError(
            "answers", "no case has the same files on both sides", "two runs of one panel", "use one --cache for both"
        )
    pairs = [(before[k], after[k]) for k in names]
    known = [(a, b) for a, b in pairs if a.good is not None]
    gained, lost = (sum(bool(x.good) and not y.good for x, y in sides) for sides in ([(b, a) for a, b in known], known))
    counted = [(a.simulations, b.simulations) for a, b in pairs if a.simulations is not None and b.simulations is not None]
    moved, common, explained = _moved(pairs)
    return Comparison(
        cases=len(pairs),
        unpaired=tuple(sorted({*before, *after} - set(names))),
        known=len(known),
        right=_pair(lambda side: sum(bool(r.good) for r in side), known),
        gained=gained,
        lost=lost,
        p_value=mcnemar(gained, lost),
        false_alarms=_pair(lambda side: sum(r.null and r.verdict == "missing_physics" for r in side), pairs),
        simulations_median=_pair(np.median, counted),
        simulations_95=_pair(lambda side: np.quantile(side, 0.95), counted),
        parameter_error=_pair(_median_error, pairs),
        coverage=_pair(_coverage, pairs),
        cpu_seconds=_pair(lambda side: sum(r.cpu_seconds for r in side), pairs),
        held_out_ratio=_ratio(pairs),
        changes=tuple(_changes(pairs)),
        moved=tuple(moved),
        common_parameters=common,
        explained_parameters=explained,
    )


def _row(*cells: object) -> str:
    return "| " + " | ".join(str(c) for c in cells) + " |"


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    return [_row(*head), _row(*("---" for _ in head)), *(_row(*r) for r in rows), ""]


def markdown(c: Comparison, before: str, after: str) -> str:
    """The comparison as Markdown tables; ``before``, ``after``: what the two sides are called."""
    figures = [
        ("right, of those with a truth", f"{c.right.before:.0f} of {c.known}", f"{c.right.after:.0f} of {c.known}"),
        ("false alarms", f"{c.false_alarms.before:.0f}", f"{c.false_alarms.after:.0f}"),
        ("simulations, median", f"{c.simulations_median.before:.0f}", f"{c.simulations_median.after:.0f}"),
        ("simulations, 95th percentile", f"{c.simulations_95.before:.0f}", f"{c.simulations_95.after:.0f}"),
        ("parameter error, median", f"{c.parameter_error.before:.2%}", f"{c.parameter_error.after:.2%}"),
        ("95 % intervals that hold the truth", f"{c.coverage.before:.1%}", f"{c.coverage.after:.1%}"),
        ("CPU time [s]", f"{c.cpu_seconds.before:.0f}", f"{c.cpu_seconds.after:.0f}"),
    ]
    loss = "a significant loss" if c.significant_loss else "no significant loss"
    lines = [
        f"# {after} against {before}: {c.cases} cases",
        "",
        f"Gained {c.gained}, lost {c.lost}; McNemar's exact test p = {c.p_value:.3g}: {loss} at {LEVEL:.0%}.",
        f"Held-out error, after over before: median {c.held_out_ratio[0]:.4f}, 95th percentile {c.held_out_ratio[1]:.4f}, "
        f"largest {c.held_out_ratio[2]:.3f}.",
        f"Parameters outside the interval before: {len(c.moved)} of {c.common_parameters}; "
        f"of explained answers: {sum(m.explained for m in c.moved)} of {c.explained_parameters}. "
        f"Cases on one side only, or of other files: {len(c.unpaired)}.",
        "",
        *_table(("", before, after), figures),
    ]
    if c.changes:
        order = {"lost": 0, "gained": 1, "changed": 2}
        rows = [(x.case, x.kind, x.before, x.after) for x in sorted(c.changes, key=lambda x: (order[x.kind], x.case))]
        lines += ["## Answers", "", *_table(("case", "", before, after), rows)]
    if c.moved:
        moved = [(m.case, m.parameter, f"{m.before:.5g} [{m.low:.5g}, {m.high:.5g}]", f"{m.after:.5g}") for m in c.moved]
        lines += ["## Parameters", "", *_table(("case", "parameter", before, after), moved)]
    return "\n".join(lines)
