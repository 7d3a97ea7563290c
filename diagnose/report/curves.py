"""What of a long record is drawn: envelopes, the stretch where the model is worst, the spectrum of the residual."""

from __future__ import annotations

import numpy as np

__all__ = ["blank", "envelope", "psd", "worst_stretch"]


def envelope(x: np.ndarray, y: np.ndarray, columns: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """At most ~2 points per column, its least and its greatest in the order of time: a drawing that hides no peak.

    Gaps (NaN) stay gaps: a column without a number is one NaN.
    """
    n = len(y)
    if n <= 2 * columns:
        return x, y
    width = -(-n // columns)
    count = -(-n // width)
    padded = np.full(count * width, np.nan)
    padded[:n] = y
    table = padded.reshape(count, width)
    empty = np.all(np.isnan(table), axis=1)
    low = np.argmin(np.where(np.isnan(table), np.inf, table), axis=1)
    high = np.argmax(np.where(np.isnan(table), -np.inf, table), axis=1)
    pairs = np.sort(np.stack([low, high], axis=1), axis=1) + (np.arange(count) * width)[:, None]
    index = np.minimum(pairs, n - 1)
    values = padded[pairs]
    values[empty] = np.nan
    return x[index.ravel()], values.ravel()


def blank(y: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """A copy with NaN where a sample does not count."""
    return np.where(counted, y, np.nan)


def worst_stretch(
    time: np.ndarray, measured: np.ndarray, predicted: np.ndarray, counted: np.ndarray, periods: float = 6.0
) -> slice:
    """The stretch in which a model errs most on samples that count, a few swings of the measured signal (N,) long."""
    n = len(time)
    e2 = np.where(counted, (measured - predicted) ** 2, 0.0)
    e2[~np.isfinite(e2)] = 0.0
    coarse = max(20, n // 20)
    centre = _peak(e2, coarse)
    near = slice(max(0, centre - coarse // 2), min(n, centre + coarse // 2))
    swings = _swings(measured[near])
    width = int(periods * (near.stop - near.start) / swings) if swings else coarse
    width = int(np.clip(width, min(60, n), max(coarse, n // 10)))
    start = int(np.clip(_peak(e2, width) - width // 2, 0, max(0, n - width)))
    return slice(start, min(n, start + width))


def _peak(e2: np.ndarray, width: int) -> int:
    """Centre of the window with the most energy."""
    running = np.cumsum(np.concatenate([[0.0], e2]))
    sums = running[width:] - running[:-width]
    return int(np.argmax(sums)) + width // 2 if len(sums) else len(e2) // 2


def _swings(y: np.ndarray) -> float:
    """Number of full periods, by crossings of the mean with a dead band against noise."""
    y = y[np.isfinite(y)]
    if not len(y):
        return 0.0
    z = y - np.mean(y)
    band = 0.3 * float(np.std(z))
    signs = np.sign(z[np.abs(z) > band])
    return float(np.count_nonzero(np.diff(signs))) / 2


def psd(e: np.ndarray, dt: float, bins: int) -> tuple[np.ndarray, np.ndarray] | None:
    """One-sided spectral density by Welch's method on ``bins`` frequencies; None when the record is too short."""
    from mjsim.signals import welch

    segment = 2 * (bins - 1)
    if segment < 8 or len(e) < segment or not np.all(np.isfinite(e)):
        return None
    return welch(e, dt, segment, level=True)
