"""Content that ends well below half the sampling rate: a filtered or interpolated channel, whose differences do not show its
noise."""

from __future__ import annotations

import numpy as np

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.spectrum import quantisation_step
from diagnose.check.thresholds import CONTENT_DROP, FLOOR_SLOPE, INTERPOLATED, STRAIGHT
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording
from mjsim.signals import welch

__all__ = ["content_end", "low_pass"]

_SEGMENT = 512  # samples: 26 lines in the tenth at the top of the band
_SEGMENTS = 4  # at least: a density by fewer is no average


@check("low_pass", "low_pass", question="Does the noise reach up to half the sampling rate?")
def low_pass(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Responses whose density falls like that of a filter up to the top of the band."""
    found = []
    for name in ("velocity", "angle"):
        x = getattr(recording, name)
        if x is None or quantisation_step(x) > 0:
            continue
        end = content_end(x, recording.dt)
        if end is not None:
            nyquist = 0.5 / recording.dt
            found.append(
                Problem(
                    name, "low_pass", end, "Hz",
                    f"The {name} holds nothing above {end:.4g} Hz, {100 * end / nyquist:.0f} % of half the sampling rate: it was "
                    "filtered, interpolated or simulated without noise, and its noise floor cannot be told by differences.",
                    "log the raw channel, or decimate the log to the rate that its content needs", Severity.LIMITS,
                )
            )  # fmt: skip
    return found


def content_end(x: np.ndarray, dt: float) -> float | None:
    """Frequency [Hz] at which the content of a filtered signal ends; None for one whose density is flat at the top of its band.

    A signal that is straight over most samples is interpolated. Else the density is that of second differences, which take the
    leakage of slow motion away, divided by their gain. It ends where it has fallen to `CONTENT_DROP` of the density of the
    noise-like part, at most.
    """
    n, bends = len(x), np.abs(np.diff(x, 2))
    straight = float(np.mean(bends <= STRAIGHT * float(np.sqrt(np.mean(bends**2)))))
    if straight > INTERPOLATED:
        return 0.5 * (1 - straight) / dt  # half the rate of the samples at which it bends
    length = min(_SEGMENT, 2 * n // (_SEGMENTS + 1))
    if length < 64:
        return None
    f, power = welch(np.diff(x, 2), dt, length)
    gain = (2 * np.sin(np.pi * f * dt)) ** 4
    density = power[1:] / np.maximum(gain[1:], 1e-12)
    share = f[1:] * 2 * dt
    upper = (share > 0.5) & (share < 0.97)
    floor = np.maximum(density, 1e-300)
    slope = float(np.polyfit(np.log(share[upper]), np.log(floor[upper]), 1)[0])
    top = float(np.median(floor[(share > 0.85) & (share < 0.97)]))
    low = float(np.median(floor[(share > 0.15) & (share < 0.25)]))
    if slope > FLOOR_SLOPE or top > CONTENT_DROP * low:
        return None
    above = np.flatnonzero(floor > low)
    return float(f[1:][above[-1]]) if len(above) else None
