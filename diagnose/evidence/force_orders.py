"""Spatial orders that stand out of the torque along a recorded motion: starts for ripple and its like, judged by force.

The residual of a torque is coloured: slow errors of the friction law hold most of its energy and would be taken for an order of
long period. What is fixed to a turning part is a line: it stands far above the orders beside it. So the residual is whitened, an
order must stand out of its neighbours (F-test, over all orders looked at), and every recorded sample is used, since at speed a
short period passes faster than decimated samples follow. Orders of fewer than `few_periods` periods over the travel have no
neighbours to stand out of, and of little more periods few: they are unsure, as is an order that stands out taken alone and not
over all, and have more to show (`diagnose.evidence.rivals.few_periods`).

With A the whitening filter and z = A' A d, the energy that sin(n q) and cos(n q) explain of A d is |sum z exp(i n q)|^2 over the
energy that passes the filter, sum |A(n v)|^2 / 2, for orders whose frequency n v changes slowly against the filter's length.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from diagnose.data.experiment import measured_velocity
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.fit.whiten import levinson
from diagnose.problem.view import ForceView
from diagnose.thresholds import ALPHA, LEADING, MOST_ORDERS, NEIGHBOURS, TAPS

__all__ = ["few_periods", "force_orders", "line_energy", "stands_out"]


def force_orders(fitter: Fitter, fitted: Fitted, most: int = 5) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Orders n (of sin(n q), q the motor's angle) of the first experiment's residual, strongest first.

    Those that stand out; and the unsure ones, which repeat too few times over the travel or stand out taken alone only.

    They range from one and a half periods over the travel to a frequency of a quarter of the sampling rate.
    """
    experiment = fitter.experiments[0]
    r = experiment.recording
    if r.angle is None or np.ptp(r.angle) <= 0 or not isinstance(fitter.view, ForceView):
        return (), ()
    view = dataclasses.replace(fitter.view, decimate=1)
    s = view.signals(fitted.axis, experiment, None)
    if s is None:
        return (), ()
    keep = view.counts(experiment)
    v = measured_velocity(r)
    travel = float(np.ptp(r.angle))
    low = 3 * np.pi / travel
    top = 0.25 * 2 * np.pi / r.dt / max(float(np.percentile(np.abs(v[keep]), 90)), 1e-12)
    if top <= low:
        return (), ()
    # two points to the width of a line, 2 pi over the travel, as far as there may be so many
    count = int(min(MOST_ORDERS, max(60.0, (top - low) * travel / np.pi)))
    grid = np.linspace(low, top, count) if count < MOST_ORDERS else np.geomspace(low, top, count)
    found: list[tuple[float, float]] = []
    few: list[tuple[float, float]] = []
    alone: list[tuple[float, float]] = []
    for weight in (np.ones(len(v)), np.sign(v)):
        power = line_energy(s.predicted - s.measured, r.angle, v, weight, keep, grid, r.dt)
        peak = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])) + 1
        chance = {int(i): stands_out(power, grid, int(i), 2 * np.pi / travel) for i in peak}
        lines = [i for i in peak if chance[int(i)] < ALPHA / len(grid)]
        alone += [(p, float(grid[i])) for i, p in chance.items() if ALPHA / len(grid) <= p < ALPHA]
        for i in sorted(lines, key=lambda i: -power[i])[:most]:
            near = np.linspace(grid[i - 1], grid[i + 1], 21)
            finer = line_energy(s.predicted - s.measured, r.angle, v, weight, keep, near, r.dt)
            found.append((float(np.max(finer)), float(near[np.argmax(finer)])))
        few += [(float(power[i]), float(grid[i])) for i in peak if grid[i] * travel < 2 * np.pi * few_periods()]
    found.sort(reverse=True)
    out: list[float] = []
    for _, n in found:
        if all(abs(n - m) > max(0.02 * m, 2 * np.pi / travel) for m in out):
            out.append(n)
    slow = tuple(dict.fromkeys(n for _, n in sorted(few, reverse=True)))  # a line may be one of both weights
    unsure = dict.fromkeys((*slow[:LEADING], *(n for _, n in sorted(alone)[:LEADING])))
    return tuple(out[:most]), tuple(n for n in unsure if all(abs(n - m) > 2 * np.pi / travel for m in out[:most]))


def few_periods() -> float:
    """Periods over the travel below which an order has no two neighbours: it cannot stand out of them."""
    return 5 / (NEIGHBOURS - 1 / NEIGHBOURS)


def stands_out(power: np.ndarray, grid: np.ndarray, i: int, width: float) -> float:
    """Probability that the energy at order i is no more than that of the orders beside it (``width``: that of one line).

    Energies of lines are chi-square with two degrees of freedom about a level; the median stands for it, so that a second line
    among the neighbours does not raise it. Neighbours closer than a line's width are one.
    """
    from scipy.stats import f

    n = grid[i]
    beside = (grid > n / NEIGHBOURS) & (grid < n * NEIGHBOURS) & (np.abs(grid - n) > 1.5 * width)
    count = int(min(np.sum(beside), (NEIGHBOURS - 1 / NEIGHBOURS) * n / width - 3))
    if count < 2:
        return 1.0
    level = float(np.median(power[beside])) / np.log(2.0)
    return float(f.sf(power[i] / max(level, 1e-300), 2, 2 * count))


def line_energy(
    d: np.ndarray, angle: np.ndarray, velocity: np.ndarray, weight: np.ndarray, keep: np.ndarray, orders: np.ndarray, dt: float
) -> np.ndarray:
    """Energy of the whitened residual d (N,) that ``weight`` (sin(n angle), cos(n angle)) explains, for each order n."""
    from scipy.signal import freqz, lfilter

    d = np.where(keep, d, 0.0)
    taps = min(TAPS, len(d) // 10)
    r = np.array([float(d[: len(d) - k] @ d[k:]) for k in range(taps + 1)])
    if r[0] <= 0:
        return np.zeros(len(orders))
    a, _ = levinson(r, taps)
    # samples that the filter reaches from a gap do not count
    valid = keep & (np.convolve(~keep, np.ones(taps + 1))[: len(keep)] == 0)
    white = np.where(valid, lfilter(a, [1.0], d), 0.0)
    z = (lfilter(a, [1.0], white[::-1])[::-1] * weight).astype(complex)
    w, response = freqz(a, worN=512)
    gain = np.abs(response) ** 2
    speed = np.abs(velocity[valid]) * dt
    # the speeds as a histogram: the energy that passes depends on nothing else
    levels, count = np.unique(np.round(speed / max(float(np.max(speed)), 1e-300), 3), return_counts=True)
    levels = levels * float(np.max(speed))
    out = np.empty(len(orders))
    for i, n in enumerate(orders):
        passed = 0.5 * float(count @ np.interp(np.minimum(n * levels, np.pi), w, gain))
        out[i] = np.abs(np.exp(1j * n * angle) @ z) ** 2 / max(passed, 1e-300)
    return out
