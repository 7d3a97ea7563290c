"""Sampled signals: rational filters as compiled recursions, power densities, limits that clip them, steps of their values.

`scipy.signal` has them too, and takes longer to load than a short diagnosis to search (docs/decisions/dependencies.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjsim.compiled import compiled

__all__ = [
    "Limit",
    "coherence",
    "filter_into",
    "freqz",
    "lfilter",
    "limits",
    "plain_step",
    "transforms",
    "value_step",
    "weigh_into",
    "welch",
    "whole_step",
]

FEW_LEVELS = 12  # of a signal that is binary or coarsely quantised


@compiled()
def filter_into(num: np.ndarray, num_delay: int, den: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    """``den(q) out(t) = num(q) x(t - num_delay)`` from rest; ``den`` is monic, coefficients in rising powers of q^-1."""
    n = x.size
    nn, nd = num.size, den.size - 1
    head = min(n, max(nn + num_delay, nd))
    for t in range(head):
        s = 0.0
        for i in range(nn):
            j = t - num_delay - i
            if j >= 0:
                s += num[i] * x[j]
        for i in range(1, nd + 1):
            if t - i >= 0:
                s -= den[i] * out[t - i]
        out[t] = s
    for t in range(head, n):
        s = 0.0
        for i in range(nn):
            s += num[i] * x[t - num_delay - i]
        for i in range(nd, 0, -1):
            s -= den[i] * out[t - i]
        out[t] = s


@compiled()
def weigh_into(
    measured: np.ndarray, predicted: np.ndarray, sigma: float, counts: np.ndarray, whitening: np.ndarray, clear: np.ndarray,
    out: np.ndarray
) -> int:  # fmt: skip
    """Write what of measured less predicted (N,) tells, from the start of ``out`` on; how many numbers that are.

    It is divided by sigma, put to 0 where it does not count, whitened by a filter in rising powers of q^-1, and taken where
    that is ``clear`` of what does not count. -1 where an error has no finite square, whether it counts or not.
    """
    n, order, at = measured.size, whitening.size, 0
    e = np.empty(n if order > 1 else 0)
    for t in range(n):
        error = measured[t] - predicted[t]
        if not abs(error) < 1e100:
            return -1
        if order > 1:
            e[t] = error / sigma if counts[t] else 0.0
        elif clear[t]:
            out[at] = error / sigma
            at += 1
    if order == 1:
        return at
    for t in range(n):
        if clear[t]:
            s = 0.0
            for i in range(min(order, t + 1)):
                s += whitening[i] * e[t - i]
            out[at] = s
            at += 1
    return at


def lfilter(b: ArrayLike, a: ArrayLike, x: ArrayLike, delay: int = 0) -> np.ndarray:
    """What ``B(q)/A(q) q^-delay``, at rest before, makes of x (N,), or of each column of x (N, k).

    b, a: coefficients in rising powers of q^-1, a[0] not 0 (`scipy.signal.lfilter` along the first axis).
    """
    b, a = np.atleast_1d(np.asarray(b, float)), np.atleast_1d(np.asarray(a, float))
    num, den = b / a[0], a / a[0]
    columns = np.array(np.asarray(x, float).T, order="C", ndmin=2)
    out = np.empty_like(columns)
    for column, filtered in zip(columns, out, strict=True):
        filter_into(num, delay, den, column, filtered)
    return out[0] if np.ndim(x) == 1 else out.T


def freqz(b: ArrayLike, a: ArrayLike, w: np.ndarray) -> np.ndarray:
    """Response of ``B(q)/A(q)``, complex (K,), at w (K,) [rad/sample]."""
    back = np.exp(-1j * w)
    up, down = (np.polyval(np.flip(np.atleast_1d(c)), back) for c in (b, a))
    return np.asarray(up / down)


def transforms(x: ArrayLike, dt: float, length: int, *, level: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) [Hz] and Fourier transforms (S, F) of the Hann-windowed segments of x, overlapping by half.

    Scaled so that the mean of abs(X)^2 over the segments is the one-sided power density [unit^2/Hz], and that of conj(U) Y the
    cross density (P. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70). ``level``: each segment keeps its mean.
    """
    segments = np.lib.stride_tricks.sliding_window_view(np.asarray(x, float), length)[:: length - length // 2]
    if not level:
        segments = segments - segments.mean(axis=1, keepdims=True)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    X = np.fft.rfft(segments * window) * np.sqrt(2 * dt / np.sum(window**2))
    X[:, 0] /= np.sqrt(2)
    if length % 2 == 0:
        X[:, -1] /= np.sqrt(2)
    return np.fft.rfftfreq(length, dt), X


def welch(x: ArrayLike, dt: float, length: int, *, level: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) [Hz] and one-sided power density (F,) [unit^2/Hz] by segments of ``length`` samples (`transforms`)."""
    f, X = transforms(x, dt, length, level=level)
    return f, np.mean(np.abs(X) ** 2, axis=0)


def coherence(u: ArrayLike, y: ArrayLike, length: int) -> np.ndarray:
    """Magnitude-squared coherence (F,) of two signals by segments of ``length`` samples; NaN where one has no power."""
    (_, U), (_, Y) = transforms(u, 1.0, length), transforms(y, 1.0, length)
    cross = np.mean(np.conj(U) * Y, axis=0)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(cross) ** 2 / (np.mean(np.abs(U) ** 2, axis=0) * np.mean(np.abs(Y) ** 2, axis=0)))


@dataclass(frozen=True)
class Limit:
    """A value that a signal is clipped at: share of its samples there, first of those that stay, how often it comes there."""

    value: float
    share: float
    first: int
    visits: int


def limits(x: np.ndarray) -> list[Limit]:
    """Where a signal (N,) stays at its own largest or smallest value for runs of samples, as a clipped one does.

    A signal of few levels (binary, coarsely quantised) is not clipped, nor is one that rests at zero. One that is quantised
    dwells on its top step too, but gets there by one step; a clipped one arrives at speed.
    """
    span = float(np.ptp(x))
    if span == 0.0 or np.unique(x[:4096]).size < FEW_LEVELS:
        return []
    found = []
    for value in (float(x.max()), float(x.min())):
        at = np.abs(x - value) <= 1e-12 * span
        runs = np.flatnonzero(at[:-1] & at[1:] & np.r_[at[2:], False])
        share = float(np.mean(at))
        entries = np.flatnonzero(~at[:-1] & at[1:])
        if runs.size <= 3 or share <= 0.005 or value == 0.0 or entries.size == 0:
            continue
        step = float(np.min(np.diff(np.unique(x))))
        if float(np.median(np.abs(x[entries + 1] - x[entries]))) > 1.5 * step:
            found.append(Limit(value, share, int(runs[0]), int(entries.size)))
    return found


def plain_step(v: np.ndarray) -> float:
    """The step of a signal that mostly stands still between steps, so that differences see no noise in it; else 0.

    It may move by several steps at once: where all moves are multiples of the smallest, that is the step, else their median.
    """
    steps = np.abs(np.diff(v))
    moved = steps[steps > 0]
    if len(moved) == 0 or len(moved) > 0.7 * len(steps):
        return 0.0
    return whole_step(moved) or float(np.median(moved))


def whole_step(moves: np.ndarray) -> float:
    """The smallest of some moves (N,) > 0 where all are multiples of it, refined by their sum; 0 where they are not."""
    if len(moves) == 0 or np.min(moves) < np.finfo(float).eps * np.max(moves):  # any multiple is whole there, by rounding
        return 0.0
    times = moves / np.min(moves)
    whole = np.round(times)
    return float(np.sum(moves) / np.sum(whole)) if np.max(np.abs(times - whole)) < 0.1 else 0.0


def value_step(values: np.ndarray) -> float:
    """The step in which values (N,) come: `plain_step`, else that of a grid on which all of them lie; 0 where there is none."""
    return plain_step(values) or whole_step(np.diff(np.unique(np.round(values, 12))))
