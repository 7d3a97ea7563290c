"""How large the noise of a recorded velocity is, before any model is asked: by what is fastest in it, and by the angle."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from diagnose.thresholds import BANDS, FASTEST, FEW_TAPS, LARGE, MOST, SEGMENT, SIGMAS, TAPS
from mjsim.recording import Recording
from mjsim.signals import transforms

__all__ = ["channel_noise", "coloured_noise_level", "white_noise_level"]


def channel_noise(recording: Recording, name: str) -> float:
    """Noise rms of the velocity or angle of a recording: its white noise, or what reading found where it was resampled."""
    return max(white_noise_level(getattr(recording, name)), recording.noise.get(name, 0.0))


def white_noise_level(y: np.ndarray) -> float:
    """Noise rms of a smooth signal: from its sixth differences, robust against the few samples at which it is not smooth.

    The sixth difference of white noise of rms s has rms s sqrt(924); that of a band-limited signal is smaller by (w dt)^6, which
    is not small where the sampling is slow. There the density of its fastest part tells, if that is clearly less.
    Source: J. von Neumann et al., Ann. Math. Stat. 12 (1941) 153, for higher differences.
    """
    d = np.diff(y, 6) / np.sqrt(924.0)
    if len(d) == 0:
        return 0.0
    smooth = float(1.4826 * np.median(np.abs(d - np.median(d))))
    fastest = _fastest_level(y)
    return fastest if fastest < MOST * smooth else smooth


def _fastest_level(y: np.ndarray) -> float:
    """Noise rms of a signal by the median density of the fastest part of its spectrum; inf where that is a few lines only.

    A line or an event there raises few of the lines. The window keeps what leaks in from the rest below 1e-9 of its power.
    """
    n = len(y)
    if n * (1.0 - FASTEST) < 100:
        return np.inf
    window = np.blackman(n) ** 2
    power = np.abs(np.fft.rfft((y - np.mean(y)) * window)) ** 2 / np.sum(window**2)
    return float(np.sqrt(np.median(power[int(FASTEST * len(power)) : -1]) / np.log(2.0)))


def coloured_noise_level(v: np.ndarray, q: np.ndarray, dt: float, white: float, angle_white: float) -> float:
    """Noise rms of a velocity (N,) whose angle (N,) is measured too, where slow noise is added to that of the fastest part.

    ``white``: what `white_noise_level` tells of the velocity, ``angle_white``: of the angle. Slow noise is smooth: differences do
    not see it, and nine parts in ten of a resonance's may be missed. Motion is in both channels, so that what of the velocity is
    not coherent with the rate of the angle is noise of one of them (a lag or gain between the sensors is coherent),

        S_v|q <= S_noise of v + min(S_motion, S_noise of the rate),    S_noise of the rate = (2 sin(w dt / 2) / dt)^2 var_q

    and the last is known, as is the sum of the two in it from the rate itself. What is clearly more than that and the white
    level, in bands up to half the Nyquist frequency, is added: no more than there is, and nothing where noise is white. Source of
    the partial spectrum: J. S. Bendat, A. G. Piersol, Random Data (2010), ch. 7.
    """
    length = min(SEGMENT, 2 ** int(np.log2(max(2 * len(v) // (BANDS + 1), 2))))
    if length < 8 * BANDS or white <= 0.0:
        return white
    rate = np.diff(q)[1:-1] / dt
    between = (13 * (v[1:-2] + v[2:-1]) - v[:-3] - v[3:]) / 24  # mean velocity from a sample to the next, to the fourth order
    # what a filter between the sensors does is taken out before the windows, at whose edges its memory is no product
    delayed = np.lib.stride_tricks.sliding_window_view(rate, TAPS)
    error = (between - rate)[TAPS - 1 - FEW_TAPS : len(rate) - FEW_TAPS]
    error = error - delayed @ np.linalg.lstsq(delayed.T @ delayed, delayed.T @ error, rcond=1e-12)[0]
    rate = rate[TAPS - 1 - FEW_TAPS : len(rate) - FEW_TAPS]
    (f, apart), (_, moved) = transforms(error, dt, length), transforms(rate, dt, length)
    count = len(apart)
    of_rate = np.mean(np.abs(moved) ** 2, axis=0)
    cross = np.mean(np.conj(moved) * apart, axis=0)
    left = np.mean(np.abs(apart) ** 2, axis=0) - np.abs(cross) ** 2 / np.maximum(of_rate, 1e-300)
    left *= count / (count - 1)  # of which chance is coherent
    level, of_angle = 2 * dt * white**2, 2 * dt * (angle_white * 2 * np.sin(np.pi * f * dt) / dt) ** 2
    more = 0.0
    edges = np.unique(np.round(np.geomspace(2, length // 4, BANDS + 1)).astype(int))
    for a, b in pairwise(edges):
        doubt = SIGMAS / np.sqrt(0.5 * count * max(1.0, 0.67 * (b - a)))  # overlapping segments and lines tell that much apiece
        found, angle, rates = (float(np.mean(x[a:b])) for x in (left, of_angle, of_rate))
        angle = min(angle, abs(rates - angle) + doubt * rates)
        if found > (level + angle) * (1 + doubt) and found - angle > LARGE * level:
            more += (found - angle - level) * (b - a) * f[1]
    return float(np.sqrt(white**2 + more))
