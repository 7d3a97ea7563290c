"""Where the content of a sampled channel ends: a filtered or interpolated one holds nothing up to half the sampling rate.

The density is that of second differences, which take the leakage of slow motion away, divided by their gain. Three signs:

- most samples lie on straight lines: the channel is interpolated linearly;
- the density falls like that of a filter up to the top of the band;
- it falls off an edge, and above that is so little that no sensor has it: the rounding of printed numbers.
"""

from __future__ import annotations

import math

import numpy as np

from diagnose.check.thresholds import CONTENT_DROP, EDGE_DROP, EDGE_SLOPE, FLOOR_SLOPE, INTERPOLATED, STRAIGHT
from diagnose.data.noise import white_noise_level
from diagnose.thresholds import ROUNDING
from mjsim.signals import welch

__all__ = ["content_end"]

_SEGMENT = 512  # samples: 26 lines in the tenth at the top of the band
_SEGMENTS = 4  # at least: a density by fewer is no average
_PARTS = 6  # of an octave, in each of which the density is averaged


def content_end(x: np.ndarray, dt: float) -> float | None:
    """Frequency [Hz] at which the content of a channel (N,), sampled every dt [s], ends; None where it fills the band."""
    n, bends = len(x), np.abs(np.diff(x, 2))
    straight = float(np.mean(bends <= STRAIGHT * float(np.sqrt(np.mean(bends**2)))))
    if straight > INTERPOLATED:
        return 0.5 * (1 - straight) / dt  # half the rate of the samples at which it bends
    length = min(_SEGMENT, 2 * n // (_SEGMENTS + 1))
    if length < 64:
        return None
    f, power = welch(np.diff(x, 2), dt, length)
    gain = (2 * np.sin(np.pi * f * dt)) ** 4
    density = np.maximum(power[1:] / np.maximum(gain[1:], 1e-12), 1e-300)
    share = f[1:] * 2 * dt
    upper = (share > 0.5) & (share < 0.97)
    slope = float(np.polyfit(np.log(share[upper]), np.log(density[upper]), 1)[0])
    top = float(np.median(density[(share > 0.85) & (share < 0.97)]))
    low = float(np.median(density[(share > 0.15) & (share < 0.25)]))
    if slope > FLOOR_SLOPE or top > CONTENT_DROP * low:
        return _edge(f[1:], density) if white_noise_level(x) < math.sqrt(ROUNDING) * _spread(x, length) else None
    edge = _edge(f[1:], density)
    return float(f[1:][np.flatnonzero(density >= low)[-1]]) if edge is None else edge


def _spread(x: np.ndarray, length: int) -> float:
    """Rms of a channel about the straight line of each segment: an axis that turns on and on has no other spread."""
    parts = x[: len(x) // length * length].reshape(-1, length).T
    t = np.linspace(-1.0, 1.0, length)
    rest = parts - parts.mean(axis=0) - np.outer(t, (t @ parts) / (t @ t))
    return float(np.sqrt(np.mean(rest**2)))


def _edge(f: np.ndarray, density: np.ndarray) -> float | None:
    """Frequency [Hz] from which a density (K,) falls by `EDGE_DROP` or more, without a rest, steeper than `EDGE_SLOPE`.

    The highest such edge, with nothing but the floor of the top above it; None without one.
    """
    at, level = np.log(f), np.log(density)
    centres = np.arange(at[0], at[-1], math.log(2) / _PARTS)
    near = [np.abs(at - c) <= 0.5 * math.log(2) / _PARTS for c in centres]
    smooth = np.array([level[m].mean() if m.any() else np.interp(c, at, level) for m, c in zip(near, centres, strict=True)])
    half = _PARTS // 2
    steep = (smooth[half:] - smooth[:-half]) / (centres[half] - centres[0]) < EDGE_SLOPE
    begins = np.flatnonzero(steep & ~np.concatenate([[False], steep[:-1]]))
    ends = np.flatnonzero(steep & ~np.concatenate([steep[1:], [False]]))
    for a, b in reversed(list(zip(begins, ends, strict=True))):
        foot = smooth[b + half]  # beneath which there is no plateau of noise
        if smooth[a] - foot > math.log(EDGE_DROP) and foot - smooth[-1] < 0.5 * math.log(EDGE_DROP):
            return float(np.exp(centres[a]))
    return None
