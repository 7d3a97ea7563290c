"""How an input goes between its samples: its value at the start of each sample and its slope over the sample.

    held:    u(t_k + s) = u_k                                        the row's value acts until the next row
    linear:  u(t_k + s) = u_k + (u_{k+1} - u_k) s / dt               the input goes in straight lines
    mean:    u(t_k + s) = m + (u_{k+2} - u_k) (s - dt/2) / 2dt       m = u_{k+1}: a row is the mean over the interval before it

The first two are exact. The third keeps the mean of each interval and is off by the second difference of the input.
Source: G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems (1998), ch. 6 (zero- and first-order hold);
P. Colella, P. R. Woodward, J. Comput. Phys. 54 (1984) 174 (reconstruction from means).
"""

from __future__ import annotations

import math

import numpy as np

from mjsim.signals import lfilter

__all__ = ["HOLDS", "at_samples", "between", "delayed", "lagged", "slewed", "within"]

HOLDS = ("held", "linear", "mean")


def between(u: np.ndarray, dt: float, hold: str) -> tuple[np.ndarray, np.ndarray]:
    """Value at the start of each sample and slope over it, each (N,), of an input u (N,) sampled every dt [s].

    Past the last sample the input is held. Raises ValueError for a hold that is not known.
    """
    if hold == "held":
        return u, np.zeros_like(u)
    if hold == "linear":
        return u, np.diff(u, append=u[-1]) / dt
    if hold == "mean":
        mean = np.append(u[1:], u[-1:])  # over the interval that begins with a row
        slope = np.gradient(mean, dt) if len(u) > 1 else np.zeros_like(u)
        return mean - 0.5 * dt * slope, slope
    raise ValueError(f"hold {hold!r}; choose from {', '.join(HOLDS)}")


def within(u: np.ndarray, dt: float, hold: str, parts: int) -> np.ndarray:
    """Means (N parts,) of an input (N,) over equal parts of each sample of dt [s]. Raises ValueError for an unknown hold."""
    start, slope = between(u, dt, hold)
    return np.asarray((start[:, None] + slope[:, None] * (np.arange(parts) + 0.5) * (dt / parts)).ravel())


def at_samples(u: np.ndarray, hold: str) -> np.ndarray:
    """Mean of an input (N, ...) about each sample, under a triangle of one sample to either side; its ends are held.

    A second difference of a position is the acceleration under the same triangle: for a body that an input drives, one equals the
    other over the inertia, whatever the hold. Raises ValueError for a hold that is not known.
    """
    before, after = np.concatenate([u[:1], u[:-1]]), np.concatenate([u[1:], u[-1:]])
    if hold == "held":
        return np.asarray(0.5 * (before + u))
    if hold == "linear":
        return np.asarray((before + 4.0 * u + after) / 6.0)
    if hold == "mean":
        return np.asarray(0.5 * (u + after))
    raise ValueError(f"hold {hold!r}; choose from {', '.join(HOLDS)}")


def delayed(x: np.ndarray, samples: float) -> np.ndarray:
    """A signal (N,) later by a number of samples (earlier by a negative one), its ends held.

    Between samples it is the cubic through four neighbours (Lagrange), of fourth order in the sample time.
    """
    whole = math.floor(samples)
    f = samples - whole
    weights = (-f * (f - 1) * (f - 2) / 6, (f + 1) * (f - 1) * (f - 2) / 2, -(f + 1) * f * (f - 2) / 2, (f + 1) * f * (f - 1) / 6)
    at = np.arange(len(x)) - whole
    return np.asarray(sum(w * x[np.clip(at - i, 0, len(x) - 1)] for w, i in zip(weights, (-1, 0, 1, 2), strict=True)))


def lagged(u: np.ndarray, lag: float, dt: float, before: float) -> np.ndarray:
    """What a first-order lag [s] makes of an input held over each sample, in its mean over the sample; settled at ``before``."""
    if lag <= 0:
        return u
    decay = math.exp(-dt / lag)
    ends = before + lfilter([0.0, 1.0 - decay], [1.0, -decay], u - before)  # at the beginning of each sample
    return np.asarray(u + (ends - u) * (1.0 - decay) * lag / dt)


def slewed(u: np.ndarray, dt: float, limit: float, hold: str) -> tuple[np.ndarray, np.ndarray]:
    """What follows an input (N,) at no more than ``limit`` per second: start and slope of each sample, each (N,).

    It ramps towards a held input and stays once it is there. Where it arrives within a sample, the ramp and the rest after it
    become the straight line of the same mean and first moment, so that what they drive is met to third order in dt.
    """
    start, slope = between(u, dt, hold)
    out, grow = np.empty_like(start), np.empty_like(start)
    now = float(start[0]) if len(start) else 0.0
    for k in range(len(start)):
        a, b = float(start[k]), float(slope[k])
        if b != 0.0:  # a moving target: towards its end, no faster than the limit
            step = min(max(a + b * dt - now, -limit * dt), limit * dt)
            out[k], grow[k] = now, step / dt
            now += step
            continue
        way = a - now
        time = abs(way) / limit
        if time >= dt:
            speed = limit if way > 0 else -limit
            out[k], grow[k] = now, speed
            now += speed * dt
            continue
        part = time / dt
        # the ramp lags the target by way (1 - s/time) up to s = time: mean way part/2, first moment about the middle
        grow[k] = way * part * (3.0 - 2.0 * part) / dt
        out[k] = a - 0.5 * way * part - 0.5 * dt * grow[k]
        now = a
    return out, grow
