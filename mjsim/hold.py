"""How an input goes between its samples: its value at the start of each sample and its slope over the sample.

    held:    u(t_k + s) = u_k                                        the row's value acts until the next row
    linear:  u(t_k + s) = u_k + (u_{k+1} - u_k) s / dt               the input goes in straight lines
    mean:    u(t_k + s) = u_k + (u_{k+1} - u_{k-1}) (s - dt/2) / 2dt the row is the mean over the sample that begins with it

The first two are exact. The third keeps the mean of each sample and is off by the second difference of the input.
Source: G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems (1998), ch. 6 (zero- and first-order hold);
P. Colella, P. R. Woodward, J. Comput. Phys. 54 (1984) 174 (reconstruction from means).
"""

from __future__ import annotations

import math

import numpy as np

__all__ = ["HOLDS", "between", "delayed", "slewed"]

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
        slope = np.gradient(u, dt) if len(u) > 1 else np.zeros_like(u)
        return u - 0.5 * dt * slope, slope
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
