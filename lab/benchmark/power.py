"""Power: how the chance to see an effect grows with its size over the noise, by logistic regression on the log of the size.

    P(seen) = 1 / (1 + exp(-(a + b log10 size)))

The likelihood is penalised by half the log-determinant of the information (Firth 1993, Biometrika 80, 27-38), so that
the fit exists where a size parts the seen from the unseen without overlap. Intervals of the sizes seen with a chance of 50 % and
90 % are those of the profile of the same likelihood: all sizes s for which some slope b > 0 makes

    2 (max log L - log L(a = logit p - b log10 s, b)) <= 3.84

On few cases they are lopsided, and open where the cases set no limit; a symmetric interval would say more than the cases do.
Source: G. Heinze, M. Schemper, Stat. Med. 21 (2002) 2409.

Curves of groups, one for each effect, share a slope (the noise is the same), each about its own size

    P(seen) = 1 / (1 + exp(-(a_g + b log10 size)))

with the same penalty, which for a given slope parts into one of each group and that of the slope. Eight cases then place a curve
that would take twenty to draw; a group in which none was missed, or none was seen, has an interval with one end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

__all__ = ["Bin", "PowerCurve", "power_curve", "power_curves", "shares"]

FEWEST = 8  # cases
OF_EACH = 2  # seen and unseen
FEWEST_IN_GROUP = 4  # cases of a group whose slope is known from the others
COMMON = np.geomspace(0.5, 50.0, 56)  # slopes [1/decade] of curves that share one
BIN = 8  # fewest cases of a bin
BINS = 8  # most bins
DROP = 1.9207  # of the log-likelihood at the ends of a 95 % interval: half the quantile of chi-square, one degree of freedom
REACH = 3.0  # decades beyond the cases, further than which an interval is called open
SLOPES = np.geomspace(0.02, 50.0, 160)  # over the fitted slope
STEP = 0.01  # decades: the first step out of the estimate


@dataclass(frozen=True)
class PowerCurve:
    """Cases by size, and the fitted curve where there are enough.

    ``at50``, ``at90``: sizes [noise rms] seen with that chance and their 95 % intervals, 0 or inf where the cases set no limit;
    nan without a fit, and ``note`` says why.
    """

    sizes: tuple[float, ...]
    seen: tuple[bool, ...]
    intercept: float
    slope: float
    at50: float
    at90: float
    at50_ci95: tuple[float, float]
    at90_ci95: tuple[float, float]
    note: str

    def chance(self, size: np.ndarray) -> np.ndarray:
        """The fitted chance at sizes [noise rms]."""
        share: np.ndarray = 1 / (1 + np.exp(-(self.intercept + self.slope * np.log10(size))))
        return share


def _fit(x: np.ndarray, y: np.ndarray) -> np.ndarray | None:
    """(a, b) by Firth's modified scores; None when it does not settle."""
    X = np.stack([np.ones_like(x), x], axis=1)
    beta: np.ndarray = np.zeros(2)
    for _ in range(200):
        p = 1 / (1 + np.exp(-np.clip(X @ beta, -30, 30)))
        w = p * (1 - p)
        information = X.T @ (w[:, None] * X)
        try:
            covariance = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return None
        leverage = w * np.einsum("ij,jk,ik->i", X, covariance, X)
        step = covariance @ (X.T @ (y - p + leverage * (0.5 - p)))
        step *= min(1.0, 2.0 / max(float(np.max(np.abs(step))), 1e-300))
        beta = beta + step
        if float(np.max(np.abs(step))) < 1e-8:
            return beta
    return None


def power_curve(sizes: Sequence[float], seen: Sequence[bool]) -> PowerCurve:
    """Fit the chance to be seen over the size [noise rms]."""
    order = sorted(range(len(sizes)), key=lambda i: sizes[i])
    s, k = tuple(float(sizes[i]) for i in order), tuple(bool(seen[i]) for i in order)
    blank = (math.nan, math.nan)
    hits = sum(k)

    def without(note: str) -> PowerCurve:
        return PowerCurve(s, k, math.nan, math.nan, math.nan, math.nan, blank, blank, note)

    if not s:
        return without("no cases")
    if min(hits, len(s) - hits) < OF_EACH or len(s) < FEWEST:
        return without(_why_not(s, k))
    fitted = _fit(np.log10(s), np.array(k, float))
    if fitted is None or fitted[1] <= 0:
        return without(f"{hits} of {len(s)} seen: the chance does not grow with the size")
    a, b = (float(v) for v in fitted)
    x, y = np.log10(s), np.array(k, float)
    at50, at90 = (10.0 ** float(np.clip((math.log(p / (1 - p)) - a) / b, -6, 6)) for p in (0.5, 0.9))
    ci50, ci90 = (_interval(p, math.log10(at), b, x, y) for p, at in ((0.5, at50), (0.9, at90)))
    return PowerCurve(s, k, a, b, at50, at90, ci50, ci90, "")


def _why_not(sizes: Sequence[float], seen: Sequence[bool]) -> str:
    """What cases in the order of their sizes say that are no curve."""
    if all(seen):
        return f"all {len(seen)} seen, the smallest at {sizes[0]:.2g}"
    if not any(seen):
        return f"none of {len(seen)} seen, the largest at {sizes[-1]:.2g}"
    return f"{sum(seen)} of {len(seen)} seen: too few for a curve"


def _log_likelihood(a: np.ndarray, b: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Penalised log-likelihood of pairs (a, b) (M,)."""
    z = a[:, None] + b[:, None] * x
    p = 1 / (1 + np.exp(-np.clip(z, -700, 700)))
    w = p * (1 - p)
    s0, s1, s2 = w.sum(1), (w * x).sum(1), (w * x * x).sum(1)
    information = np.maximum(s0 * s2 - s1**2, 1e-300)
    return np.asarray(-np.logaddexp(0.0, np.where(y > 0, -z, z)).sum(1) + 0.5 * np.log(information))


def _interval(chance: float, at: float, slope: float, x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Profile interval of the size seen with a chance, about the estimate ``at`` [decades] of the fit with this slope."""
    level = math.log(chance / (1 - chance))
    slopes = slope * SLOPES

    def below(g: float) -> float:
        """How far the profile at g is below its top."""
        return top - float(np.max(_log_likelihood(level - slopes * g, slopes, x, y)))

    top = float(np.max(_log_likelihood(level - slopes * at, slopes, x, y)))

    def end(side: float, limit: float) -> float | None:
        inside, step = at, STEP
        while below(inside + side * step) <= DROP:
            inside += side * step
            step *= 1.5
            if side * (limit - inside) < 0:
                return None
        outside = inside + side * step
        for _ in range(12):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if below(middle) <= DROP else (inside, middle)
        return inside

    low, high = end(-1.0, x[0] - REACH), end(1.0, x[-1] + REACH)
    return 0.0 if low is None else 10.0**low, math.inf if high is None else 10.0**high


def power_curves(groups: Mapping[str, tuple[Sequence[float], Sequence[bool]]]) -> dict[str, PowerCurve]:
    """Curves of groups (sizes [noise rms], seen) that share a slope, each with its own sizes seen with 50 % and 90 %."""
    cases = {}
    for name, (sizes, seen) in groups.items():
        order = sorted(range(len(sizes)), key=lambda i: sizes[i])
        cases[name] = tuple(float(sizes[i]) for i in order), tuple(bool(seen[i]) for i in order)
    mixed = [name for name, (s, k) in cases.items() if len(s) >= FEWEST_IN_GROUP and 0 < sum(k) < len(s)]
    blank = PowerCurve((), (), math.nan, math.nan, math.nan, math.nan, (math.nan,) * 2, (math.nan,) * 2, "no cases")
    out = {name: replace(blank, sizes=s, seen=k, note=_why_not(s, k)) if s else blank for name, (s, k) in cases.items()}
    if sum(len(cases[name][0]) for name in mixed) < FEWEST:
        return out
    drawn = [name for name, (s, _) in cases.items() if len(s) >= FEWEST_IN_GROUP]
    x = {name: np.log10(cases[name][0]) for name in drawn}
    y = {name: np.array(cases[name][1], float) for name in drawn}
    # the middle of each curve [decades], and how likely its cases are about it, for every slope
    middles = {name: np.arange(x[name][0] - REACH, x[name][-1] + REACH, STEP) for name in drawn}
    likely = {name: _of_group(COMMON[:, None], -COMMON[:, None] * middles[name], x[name], y[name]) for name in drawn}
    best = {name: likely[name][0].max(axis=1) for name in drawn}
    at = {name: likely[name][0].argmax(axis=1) for name in drawn}
    spread = np.sum([np.take_along_axis(likely[n][1], at[n][:, None], axis=1)[:, 0] for n in mixed], axis=0)
    total = np.sum([best[n] for n in mixed], axis=0) + 0.5 * np.log(np.maximum(spread, 1e-300))
    slope = float(COMMON[np.argmax(total)])
    for name in drawn:
        rest = total - (best[name] if name in mixed else 0.0)
        points = {}
        for chance in (0.5, 0.9):
            level = math.log(chance / (1 - chance))
            moved = middles[name] if chance == 0.5 else middles[name] + level / slope
            value = likely[name][0] if chance == 0.5 else _of_group(
                COMMON[:, None], level - COMMON[:, None] * moved, x[name], y[name])[0]  # fmt: skip
            profile = (value + rest[:, None]).max(axis=0)
            inside = np.flatnonzero(profile >= profile.max() - DROP)
            low, high = inside[0], inside[-1]
            # where none was missed, or none seen, only the penalty sets the other end
            open_low, open_high = low == 0 or all(cases[name][1]), high == len(moved) - 1 or not any(cases[name][1])
            ends = (0.0 if open_low else float(10.0 ** moved[low]), math.inf if open_high else float(10.0 ** moved[high]))
            points[chance] = (float(10.0 ** moved[int(profile.argmax())]), ends)
        if name in mixed:
            middle = float(np.log10(points[0.5][0]))
            out[name] = replace(
                out[name], intercept=-slope * middle, slope=slope, at50=points[0.5][0], at90=points[0.9][0],
                at50_ci95=points[0.5][1], at90_ci95=points[0.9][1], note="",
            )  # fmt: skip
        else:
            out[name] = replace(out[name], at50_ci95=points[0.5][1], at90_ci95=points[0.9][1])
    return out


def _of_group(slope: np.ndarray, intercept: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log-likelihood of a group's cases, penalised for its intercept, and its part in the information on the slope."""
    z = intercept[..., None] + slope[..., None] * x
    p = 1 / (1 + np.exp(-np.clip(z, -700, 700)))
    w = p * (1 - p)
    s0, s1, s2 = w.sum(-1), (w * x).sum(-1), (w * x * x).sum(-1)
    likely = -np.logaddexp(0.0, np.where(y > 0, -z, z)).sum(-1) + 0.5 * np.log(np.maximum(s0, 1e-300))
    return likely, np.maximum(s2 - s1**2 / np.maximum(s0, 1e-300), 0.0)


@dataclass(frozen=True)
class Bin:
    """Cases of like size: their smallest and largest size, how many were seen, and the Clopper-Pearson interval of the share."""

    low: float
    high: float
    n: int
    seen: int
    ci95: tuple[float, float]


def shares(sizes: Sequence[float], seen: Sequence[bool]) -> tuple[Bin, ...]:
    """The observed shares in bins of equal count, to judge a fitted curve by; none below two bins of ``BIN`` cases."""
    from scipy.stats import binomtest

    order = sorted(range(len(sizes)), key=lambda i: sizes[i])
    count = min(BINS, len(order) // BIN)
    out = []
    for part in np.array_split(np.array(order, int), count) if count >= 2 else ():
        hits = sum(bool(seen[i]) for i in part)
        limits = binomtest(hits, len(part)).proportion_ci(0.95, method="exact")
        out.append(Bin(sizes[part[0]], sizes[part[-1]], len(part), hits, (float(limits.low), float(limits.high))))
    return tuple(out)
