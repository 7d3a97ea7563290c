"""Which spatial frequencies of the motor angle stand out of a residual: starts for ripple, transmission error and their like.

A torque locked to the angle, cos(n q) or sin(n q), reaches the velocity through the fitted linear axis. For each order n the
residual's energy that the two regressors explain is computed; peaks over n are the orders. All orders are ranked by one
product each (the residual filtered backwards, the energy of the regressors taken at the momentary frequency), the best exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from diagnose.fit.whiten import levinson
from diagnose.thresholds import FEW_TAPS
from mjsim.axis import Axis
from mjsim.signals import freqz, lfilter
from mjsim.system import assemble, restoring, state_matrix

__all__ = ["find_orders", "torque_to_velocity"]

Run = Callable[[Sequence[Callable[[], float]]], list[float]]


def torque_to_velocity(
    axis: Axis, dt: float, body: int = 0, about: float = 0.0, *, by_velocity: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Discrete transfer function (b, a) from a torque on a body, held over dt, to the velocity of body 0.

    Of the effects, gravity and springs that hold the axis near an angle ``about`` [rad | m] are part of it. Under a servo, whose
    model is judged on its angle: to the angle of body 0, unless ``by_velocity``.
    """
    linear = Axis(axis.chain)
    s = assemble(linear)
    n = s.n
    a = state_matrix(s.f, np.append(s.servo[0], np.zeros(n - 1)))
    a[n, n] -= s.servo[1] / s.f[0, 0]
    b = np.zeros((2 * n, 1))
    b[n + body] = 1.0 / s.f[0, body]
    if axis.chain.servo is not None and not by_velocity:
        return _discrete(a, b, np.eye(1, 2 * n), dt)
    held = restoring(axis, about)
    if held.any():
        swinging = state_matrix(s.f, held)
        if np.max(np.linalg.eigvals(swinging).real) < 0:  # elsewhere it falls over, as no linear model follows for long
            return _discrete(swinging, b, np.eye(1, 2 * n, n), dt)
    # drop the rigid-body position: angles relative to a rigid chain, so that the system has no integrator
    t = np.eye(2 * n)
    for i in range(1, n):
        t[i, 0] = -axis.chain.total_ratio(i)
    keep = np.arange(1, 2 * n)
    inv = np.linalg.inv(t)
    a = (t @ a @ inv)[np.ix_(keep, keep)]
    b = (t @ b)[keep]
    c = np.zeros((1, 2 * n))
    c[0, n] = 1.0
    c = (c @ inv)[:, keep]
    return _discrete(a, b, c, dt)


def _discrete(a: np.ndarray, b: np.ndarray, c: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Discrete transfer function (b, a) of x' = A x + B u, y = C x, with u held over dt."""
    from scipy.linalg import expm

    m = expm(np.block([[a, b], [np.zeros((1, len(a) + 1))]]) * dt)
    held, entered = m[:-1, :-1], m[:-1, -1:]
    den = np.poly(held)
    return np.poly(held - entered @ c) - den, den  # det(zI - A + b c) - det(zI - A) = c adj(zI - A) b


def _waves(y: np.ndarray, angle: np.ndarray, low: float, top: float) -> tuple[np.ndarray, np.ndarray]:
    """Orders from low to top, four within the width of a line, and |sum y exp(i n angle)|^2 there, by an FFT over the angle."""
    width = 2 * np.pi / (16 * top)
    over = np.bincount(((angle - angle.min()) / width).astype(int), weights=y)
    length = 4 * len(over)
    orders = 2 * np.pi * np.arange(length // 2 + 1) / (length * width)
    inside = (orders >= low) & (orders <= top)
    return orders[inside], np.abs(np.fft.rfft(over, length)[inside]) ** 2


def _in_turn(tasks: Sequence[Callable[[], float]]) -> list[float]:
    return [task() for task in tasks]


def find_orders(
    residual: np.ndarray, angle: np.ndarray, velocity: np.ndarray, b: np.ndarray, a: np.ndarray, dt: float, *, most: int = 5,
    keep: np.ndarray | None = None, run: Run = _in_turn, inertia: bool = False,
) -> tuple[float, ...]:  # fmt: skip
    """Orders (cycles per unit angle / 2 pi, i.e. n in sin(n q)) at which the residual has most energy, strongest first.

    residual, angle, velocity (N,): velocity residual, measured motor angle and velocity; (b, a): torque to velocity.
    Orders range from one period over the travel to the one whose frequency reaches a quarter of the sampling rate.
    ``run``: works out tasks, side by side perhaps. ``inertia``: of an inertia that varies over the turn, whose torque is
    sin(n q) q'' + n cos(n q) q'^2 / 2; angle, velocity and (b, a) are then those of its body, the velocity simulated.
    """
    travel = float(np.ptp(angle))
    if travel <= 0:
        return ()
    top = min(0.25 * 2 * np.pi / dt / max(float(np.percentile(np.abs(velocity), 90)), 1e-12), 60 * 2 * np.pi / travel * 20)
    low = 2 * np.pi / travel * 1.5
    if top <= low:  # a fast and short motion: its waves are too fast for the sampling, or longer than the travel
        return ()
    mask = np.ones(len(residual), bool) if keep is None else keep
    # an axis integrates: what is slow and large in the residual fits waves of many orders: whitened away on both sides
    level = residual - residual.mean()
    white, _ = levinson(np.array([float(level[: len(level) - k] @ level[k:]) for k in range(FEW_TAPS + 1)]), FEW_TAPS)
    y, b = lfilter(white, [1.0], level) * mask, np.convolve(b, white)
    # correlating with a filtered wave is correlating the wave with what the transposed filter makes of the residual
    z = lfilter(b, a, y[::-1])[::-1]
    if not np.isfinite(z).all():  # an unstable axis, whose response grows beyond all numbers
        return ()
    near = np.geomspace(1e-4, np.pi, 400)
    response = np.abs(freqz(b, a, near)) ** 2
    found: list[tuple[float, float]] = []
    weights = (np.gradient(velocity, dt), velocity**2) if inertia else (np.ones(len(angle)), np.sign(velocity))
    waves = [_waves(weight * z, angle, low, top) for weight in weights]
    grid = waves[0][0]
    if len(grid) == 0:
        return ()
    # the energy behind the filter, where the speed changes slowly: a smooth function of the order
    few = np.geomspace(low, top, 60)
    sizes = np.stack([weight**2 * mask for weight in weights], axis=1) if inertia else mask[:, None]
    energies = run([partial(lambda n: 0.5 * np.interp(n * np.abs(velocity) * dt, near, response) @ sizes, n) for n in few])
    energy = [np.maximum(np.interp(grid, few, e), 1e-300) for e in np.array(energies).T]
    # integer orders are likely: a turn of the motor is a period of what is fixed to it
    whole = np.arange(1.0, min(top, 64.0) + 0.5)
    nearest = np.unique(np.searchsorted(grid, whole).clip(0, len(grid) - 1))
    grid[nearest] = np.array([whole[np.argmin(np.abs(whole - grid[i]))] for i in nearest])
    roughs = np.stack([power / energy[min(k, len(energy) - 1)] for k, (_, power) in enumerate(waves)], axis=1)

    def explained(n: float, weight: np.ndarray) -> float:
        wave = np.column_stack([np.sin(n * angle), np.cos(n * angle)])
        if inertia:
            x = wave * weights[0][:, None] + 0.5 * n * (wave[:, ::-1] * [1.0, -1.0]) * weights[1][:, None]
        else:
            x = wave * weight[:, None]
        x = lfilter(b, a, x) * mask[:, None]
        c = x.T @ y
        return float(c @ np.linalg.lstsq(x.T @ x, c, rcond=1e-12)[0])

    for weight, rough in zip(weights, roughs.T, strict=True):
        at_top = [i for i in range(len(grid)) if rough[i] >= max(rough[max(i - 1, 0)], rough[min(i + 1, len(grid) - 1)])]
        best = [float(grid[i]) for i in sorted(at_top, key=lambda i: -rough[i])[: 3 * most]]
        found += zip(run([partial(explained, n, weight) for n in best]), best, strict=True)
    found.sort(reverse=True)
    out: list[float] = []
    for _, n in found:
        if all(abs(n - m) > 0.02 * m for m in out):
            out.append(n)
    return tuple(out[:most])
