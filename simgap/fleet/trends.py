"""What the table of a fleet shows: drift over dates, robots unlike the others, recordings that have to be made again."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from scipy import stats

__all__ = ["Drift", "Outlier", "drifts", "outliers", "to_record_again"]

LEVEL = 0.05  # family-wise, over all series that are tested (Holm)
FEWEST_DATES = 4  # two are needed for a line and two for its error
FEWEST_ROBOTS = 5  # a median absolute deviation of fewer says little
FAR = 3.5  # modified z-score of an outlier: B. Iglewicz, D. Hoaglin, How to Detect and Handle Outliers (1993)
DAY = 86_400.0
AGAIN = ("unexplained", "refused", "failed")

Series = tuple[str, str, str, str, str]  # robot, joint, effect, parameter, unit


@dataclass(frozen=True)
class Drift:
    """A parameter that changes with the date: slope [unit a day] with its 95 % interval, p-value before correction, points."""

    robot: str
    joint: str
    effect: str
    parameter: str
    unit: str
    per_day: float
    low: float
    high: float
    p_value: float
    days: tuple[float, ...]
    values: tuple[float, ...]


@dataclass(frozen=True)
class Outlier:
    """A robot whose median of a parameter is unlike those of the other robots; score: modified z-score."""

    robot: str
    joint: str
    effect: str
    parameter: str
    unit: str
    value: float
    median: float
    score: float


def _series(table: Iterable[Mapping[str, Any]]) -> dict[Series, list[tuple[float, float, float]]]:
    """(time [s], value, standard error) of each parameter of each robot."""
    out: dict[Series, list[tuple[float, float, float]]] = defaultdict(list)
    for r in table:
        if r["effect"] and r["value"] is not None and math.isfinite(r["value"]):
            error = (r["high"] - r["low"]) / (2 * 1.96) if r["high"] is not None and r["low"] is not None else math.nan
            time = datetime.fromisoformat(r["date"]).timestamp()
            out[(r["robot"], r["joint"] or "", r["effect"], r["parameter"], r["unit"] or "")].append((time, r["value"], error))
    return out


def drifts(table: Iterable[Mapping[str, Any]]) -> list[Drift]:
    """Series whose slope over the dates differs from zero, by Holm's correction over all of them.

    The line is fitted with weights 1 / error^2; its standard error is scaled by the scatter about it where that is larger than
    the errors say (Birge ratio): values of one robot may differ by more than their intervals.
    """
    found = [d for key, points in _series(table).items() if (d := _drift(key, points)) is not None]
    found.sort(key=lambda d: d.p_value)
    kept = []
    for i, d in enumerate(found):
        if d.p_value > LEVEL / (len(found) - i):
            break
        kept.append(d)
    return kept


def _drift(key: Series, points: Sequence[tuple[float, float, float]]) -> Drift | None:
    t, y, error = np.array(sorted(points)).T
    if len(np.unique(t)) < FEWEST_DATES:
        return None
    days = (t - t[0]) / DAY
    known = np.isfinite(error) & (error > 0)
    w = 1 / np.where(known, error, np.median(error[known]) if known.any() else 1.0) ** 2
    X = np.column_stack([np.ones_like(days), days])
    covariance = np.linalg.inv(X.T @ (w[:, None] * X))
    b = covariance @ (X.T @ (w * y))
    freedom = len(y) - 2
    scatter = float(np.sum(w * (y - X @ b) ** 2)) / freedom
    se = math.sqrt(covariance[1, 1] * (max(1.0, scatter) if known.any() else scatter))
    if se == 0:
        return None
    p = 2 * float(stats.t.sf(abs(b[1]) / se, freedom))
    half = float(stats.t.ppf(0.975, freedom)) * se
    slope = float(b[1])
    return Drift(*key, slope, slope - half, slope + half, p, tuple(map(float, days)), tuple(map(float, y)))


def outliers(table: Iterable[Mapping[str, Any]]) -> list[Outlier]:
    """Robots whose median of a parameter has a modified z-score above `FAR` among at least `FEWEST_ROBOTS` robots.

    score = 0.6745 (value - median) / MAD.
    """
    by: dict[tuple[str, str, str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for (robot, *rest), points in _series(table).items():
        by[tuple(rest)][robot] += [v for _, v, _ in points]  # type: ignore[index]
    out = []
    for (joint, effect, parameter, unit), robots in by.items():
        if len(robots) < FEWEST_ROBOTS:
            continue
        values = {robot: float(np.median(v)) for robot, v in robots.items()}
        middle = float(np.median(list(values.values())))
        spread = float(np.median([abs(v - middle) for v in values.values()]))
        if spread == 0:
            continue
        for robot, value in values.items():
            score = 0.6745 * (value - middle) / spread
            if abs(score) > FAR:
                out.append(Outlier(robot, joint, effect, parameter, unit, value, middle, score))
    return sorted(out, key=lambda o: -abs(o.score))


def to_record_again(table: Iterable[Mapping[str, Any]]) -> list[tuple[str, str, str, str]]:
    """(robot, log, verdict, what to do) of recordings that gave no answer."""
    out: dict[str, tuple[str, str, str, str]] = {}
    for r in table:
        if r["verdict"] in AGAIN:
            todo = r["problem"] or r["next_experiment"] or r["summary"] or ""
            out.setdefault(r["key"], (r["robot"], r["log"], r["verdict"], todo))
    return sorted(out.values())
