"""Grades: how many cases of each level, and the bars that a full grade is held against."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lab.benchmark.cases import LEVELS
from lab.benchmark.score import CaseScore
from mjsim.errors import InputError, nearest

__all__ = ["BUDGETS", "GRADES", "HIDDEN", "Bar", "Status", "bars", "fraction", "parse_levels"]

# Quick: some minutes on two cores. Full: 180 nulls, so that two false alarms still leave the upper limit below 4 %, and eight
# faint cases of each effect, the fewest that a curve of power is drawn from.
GRADES: dict[str, dict[str, int]] = {
    "quick": {
        "plain": 6, "under_noise": 3, "behind_refit": 2, "behind_feedback": 2, "two_effects": 2, "other_law": 2,
        "out_of_library": 2, "nothing": 3, "parameters_only": 2, "faint": 1, "coloured": 2,
    },
    "full": {
        "plain": 99, "under_noise": 48, "behind_refit": 40, "behind_feedback": 40, "two_effects": 40, "other_law": 20,
        "out_of_library": 45, "nothing": 90, "parameters_only": 90, "faint": 200, "coloured": 20,
    },
}  # fmt: skip

# Seconds after which a diagnosis tries no further structure.
BUDGETS = {"quick": 120.0, "full": math.inf}

HIDDEN = ("under_noise", "behind_refit", "behind_feedback")
SINGLE = ("plain", *HIDDEN, "faint")  # for the curves of power
LIBRARY = ("plain", *HIDDEN, "two_effects")
VISIBLE = 0.3  # noise rms


class Status(enum.Enum):
    """Whether a bar is met; the value stands in the JSON."""

    HOLDS = "holds"
    FAILS = "fails"
    TOO_FEW = "too few cases"


@dataclass(frozen=True)
class Bar:
    """One bar: what is asked, the figure, on how many cases or numbers, and whether it holds.

    ``interval``: 95 % Clopper-Pearson for a share, the quartiles for a median. ``certain``: the whole interval of a share lies on
    the side of the figure.
    """

    id: str
    text: str
    asked: str
    value: float
    interval: tuple[float, float] | None
    n: int
    status: Status
    share: bool = True
    certain: bool = True

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "status": self.status.value}


def fraction(hits: int, n: int) -> tuple[float, tuple[float, float]]:
    """A share and its two-sided 95 % Clopper-Pearson interval."""
    from scipy.stats import binomtest

    if n == 0:
        return float("nan"), (0.0, 1.0)
    limits = binomtest(hits, n).proportion_ci(0.95, method="exact")
    return hits / n, (float(limits.low), float(limits.high))


def parse_levels(text: str | None, grade: str) -> dict[str, int]:
    """``LEVEL`` or ``LEVEL:COUNT`` with commas -> cases of each level; the grade's own counts where none is given."""
    counts = GRADES[grade]
    if text is None:
        return dict(counts)
    out: dict[str, int] = {}
    for item in text.split(","):
        name, _, number = item.strip().partition(":")
        if name not in LEVELS:
            raise InputError("--levels", f"{name!r} is not known", f"one of {', '.join(LEVELS)}", nearest(name, LEVELS))
        if number and not (number.isdigit() and int(number) > 0):
            raise InputError("--levels", f"{item.strip()!r} has no usable count", "LEVEL:COUNT with a whole count from 1")
        out[name] = int(number) if number else counts[name]
    return out


def _share(id: str, text: str, asked: str, hits: Sequence[bool], least: float = 0.0, most: float = 1.0) -> Bar:
    n = len(hits)
    value, (low, high) = fraction(sum(hits), n)
    if not any(least <= k / n <= most for k in range(n + 1) if n):  # no number of hits could meet it
        return Bar(id, text, asked, value, (low, high) if n else None, n, Status.TOO_FEW, certain=False)
    holds = least <= value <= most
    certain = least <= low and high <= most if holds else high < least or low > most
    return Bar(id, text, asked, value, (low, high), n, Status.HOLDS if holds else Status.FAILS, certain=certain)


def _median(id: str, text: str, asked: str, values: Sequence[float], least: float = -np.inf, most: float = np.inf) -> Bar:
    if not values:
        return Bar(id, text, asked, float("nan"), None, 0, Status.TOO_FEW, certain=False)
    value = float(np.median(values))
    quarters = float(np.quantile(values, 0.25)), float(np.quantile(values, 0.75))
    status = Status.HOLDS if least <= value <= most else Status.FAILS
    return Bar(id, text, asked, value, quarters, len(values), status)


def visible(c: CaseScore) -> bool:
    """What the effect changes in the output, less what other linear parameters could mimic, is at least 0.3 of the noise."""
    return c.size.get("after_refit", 0.0) >= VISIBLE


def bars(cases: Sequence[CaseScore]) -> list[Bar]:
    """Every bar with its figure."""
    by: Mapping[str, list[CaseScore]] = {level: [c for c in cases if c.level == level] for level in LEVELS}
    nulls = [c for c in cases if c.null]
    alarms = [c.verdict == "missing_physics" for c in nulls]
    rate = _share("false_alarms", "False alarms where nothing is missing", "≤ 2 %", alarms, most=0.02)
    upper = fraction(sum(alarms), len(alarms))[1][1] if nulls else float("nan")
    decidable = bool(nulls) and fraction(0, len(nulls))[1][1] <= 0.04
    status = Status.HOLDS if upper <= 0.04 else Status.FAILS if decidable or sum(alarms) else Status.TOO_FEW
    limit = Bar("false_alarms_limit", "Upper 95 % limit of false alarms", "≤ 4 %", upper, None, len(nulls), status)
    library = [c for c in cases if c.level in LIBRARY]
    numbers = [p for c in library if c.contract_law for p in c.parameters]
    hidden = [c for level in HIDDEN for c in by[level] if visible(c)]
    # one that was not found closes nothing
    gaps = [c.gap for c in library if np.isfinite(c.gap)]
    return [
        rate,
        limit,
        _share("plain", "Plain single effects: verdict and effect right", "≥ 97 %", _good(by["plain"]), 0.97),
        _share("hidden", "Hidden effects of at least 0.3 noise rms: right", "≥ 90 %", _good(hidden), 0.90),
        _share("pairs", "Pairs: both right", "≥ 85 %", _good(by["two_effects"]), 0.85),
        _share("out_of_library", "Outside the library: a wrong name given as the answer", "≤ 5 %",
               [c.verdict == "missing_physics" for c in by["out_of_library"]], most=0.05),
        _median("parameter_error", "Median parameter error", "≤ 3 %", [p.error for p in numbers if p.counted], most=0.03),
        _share("coverage", "95 % intervals that hold the truth", "90 … 98 %",
               [p.inside for p in numbers if p.inside is not None], 0.90, 0.98),
        _median("gap_closed", "Gap closed on held-out data, median", "≥ 98 %", gaps, least=0.98),
    ]  # fmt: skip


def _good(cases: Sequence[CaseScore]) -> list[bool]:
    return [c.outcome.good for c in cases]
