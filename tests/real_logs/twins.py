"""Small machines with laws of their own, and the ways in which their logs are taken: twins of logs that misled a diagnosis.

Friction here is that of Dahl and LuGre in closed form over a step; nothing is shared with `mjsim`. Integration is by small
semi-implicit Euler steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from mjsim.recording import Recording

Torque = Callable[[float, float, float, float], float]
"""Torque on the body by time, angle, velocity and input."""


def wave(rng: np.random.Generator, t: np.ndarray, low: float, high: float, count: int = 8) -> np.ndarray:
    """Sines of random frequency [Hz] and phase, rms 1, from rest."""
    w = sum(rng.uniform(0.4, 1) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in rng.uniform(low, high, count))
    return np.asarray(w / np.std(w) * np.minimum(1.0, t / 0.3))


class Bristle:
    """Friction of a bristle that bends and slips: Coulomb level, and a higher level at rest that fades over a speed."""

    def __init__(self, level: float, static: float = 0.0, speed: float = 0.3, stiffness: float = 0.0) -> None:
        self.level, self.static, self.speed = level, static or level, speed
        self.stiffness, self.bend = stiffness or 800.0 * level, 0.0

    def __call__(self, v: float, h: float) -> float:
        limit = self.level + (self.static - self.level) * math.exp(-((v / self.speed) ** 2))
        self.bend = (self.bend + h * v) / (1.0 + h * self.stiffness * abs(v) / limit)
        return self.stiffness * self.bend


def run(
    u: np.ndarray | Callable[[int, float, float], float], rate: float, inertia: float, torque: Torque, *,
    friction: Bristle | None = None, samples: int = 0, substeps: int = 10, late: int = 0, start: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Input, angle and velocity (N,) of a body; ``u``: input, or a controller by sample, angle and velocity; late: in samples."""
    n = samples or len(u)  # type: ignore[arg-type]
    h, q, v = 1.0 / rate / substeps, start, 0.0
    out = np.empty((3, n))
    for k in range(n):
        asked = u(k, q, v) if callable(u) else u[k]
        out[:, k] = asked, q, v
        acting = out[0, k - late] if k >= late else 0.0
        for i in range(substeps):
            rub = friction(v, h) if friction else 0.0
            v += h * (torque((k * substeps + i) * h, q, v, acting) - rub) / inertia
            q += h * v
    return out[0], out[1], out[2]


def low_passed(x: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Forwards and backwards through a Butterworth filter, as a post-processed log is."""
    from scipy.signal import butter, filtfilt

    b, a = butter(4, 2 * cutoff / rate)
    return np.asarray(filtfilt(b, a, x))


def recording(rate: float, u: np.ndarray, v: np.ndarray | None, q: np.ndarray | None, name: str, **more: object) -> Recording:
    """A log of some channels."""
    return Recording(np.arange(len(u)) / rate, u, v, q, 1 / rate, source=name, **more)  # type: ignore[arg-type]


@lru_cache(8)  # several tests ask for the same
def motor(seed: int, rate: float = 500, seconds: float = 6.0, level: float = 0.06, noise: float = 0.02) -> tuple[np.ndarray, ...]:
    """Torque, velocity and angle (N,) of a motor of 0.012 kg m^2 with 0.05 N m s/rad and dry friction."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    u, q, v = run(
        0.5 * wave(rng, t, 0.3, 4.0), rate, 0.012, lambda _t, _q, v, u: u - 0.05 * v, friction=Bristle(level) if level else None
    )
    return u, v + noise * rng.standard_normal(len(t)), q + 0.005 * noise * rng.standard_normal(len(t))
