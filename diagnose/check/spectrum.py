"""A sampled signal as its straight line and the spectrum of the rest, from which derivatives, shifts and decimation are exact."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from diagnose.data.noise import white_noise_level

__all__ = ["Spectrum", "clear_band", "noise_level", "quantisation_step"]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """x(t) = start + slope t + the odd extension of the rest, as Fourier coefficients (K,) up to a frequency.

    duration: (N - 1) dt [s]; frequency: (K,) [Hz], multiples of 1 / (2 duration). The extension is continuous with its first
    derivative, so that the coefficients of a smooth signal fall fast. Coefficients are those of a unit-spaced irfft, divided by N
    - 1.
    """

    start: float
    slope: float
    duration: float
    coefficient: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, dt: float, top: float) -> Spectrum:
        """From samples (N,) every dt [s], up to ``top`` [Hz]."""
        n = len(x)
        duration = (n - 1) * dt
        slope = float(x[-1] - x[0]) / duration
        rest = x - x[0] - slope * dt * np.arange(n)
        extended = np.concatenate([rest, -rest[-2:0:-1]])
        count = min(math.floor(top * 2 * duration) + 1, n - 1)
        return cls(float(x[0]), slope, duration, np.fft.rfft(extended)[:count] / (n - 1))

    @property
    def frequency(self) -> np.ndarray:
        """(K,) [Hz]."""
        return np.arange(len(self.coefficient)) / (2 * self.duration)

    def filtered(self, response: np.ndarray, count: int) -> np.ndarray:
        """The rest through a response (K,), at ``count`` + 1 equidistant times; frequencies above its Nyquist are cut."""
        kept = min(count, len(self.coefficient))
        spectrum = np.zeros(count + 1, complex)
        spectrum[:kept] = self.coefficient[:kept] * response[:kept]
        return np.asarray(np.fft.irfft(spectrum, 2 * count)[: count + 1] * count)

    def derivative(self, order: int, count: int) -> np.ndarray:
        """The derivative of an order >= 0 at ``count`` + 1 equidistant times, line included."""
        out = self.filtered((2j * math.pi * self.frequency) ** order, count)
        if order == 0:
            out = out + self.start + self.slope * np.linspace(0.0, self.duration, count + 1)
        return out + self.slope if order == 1 else out

    def through(self, response: np.ndarray, count: int) -> np.ndarray:
        """The signal through a response (K,), its line by the response at rest, at ``count`` + 1 equidistant times."""
        line = self.start + self.slope * np.linspace(0.0, self.duration, count + 1)
        return self.filtered(response, count) + line * float(response[0].real)

    def delayed(self, delay: float | np.ndarray, response: np.ndarray, count: int) -> np.ndarray:
        """The signal ``delay`` [s] ago, through a response (K,), its line by the response at rest, at ``count`` + 1 times.

        (M,) for one delay, (M, G) for delays (G,).
        """
        each = np.atleast_1d(delay)[:, None]
        kept = min(count, len(self.coefficient))
        spectrum = np.zeros((len(each), count + 1), complex)
        turn = np.exp(-2j * math.pi * self.frequency[:kept] * each)
        spectrum[:, :kept] = self.coefficient[:kept] * response[:kept] * turn
        turned = np.fft.irfft(spectrum, 2 * count, axis=1)[:, : count + 1] * count
        line = self.start + self.slope * (np.linspace(0.0, self.duration, count + 1) - each)
        out = turned + line * float(response[0].real)
        return np.asarray(out[0] if np.ndim(delay) == 0 else out.T)


def quantisation_step(x: np.ndarray) -> float:
    """The step of a rounded signal: the largest step of which all its differences are multiples; 0 when there is none.

    Differences that are multiples of a step to 1e-3 of it, at least eight of them distinct samples.
    """
    moves = np.abs(np.diff(x[:20_000]))
    moves = moves[moves > 1e-12 * max(float(np.max(np.abs(x))), 1e-300)]
    if len(moves) < 8:
        return 0.0
    smallest = float(np.min(moves))
    parts = moves / smallest
    whole = np.round(parts)
    if np.max(np.abs(parts - whole)) > 0.05 or np.max(whole) > 1e6:
        return 0.0
    step = float(np.sum(moves) / np.sum(whole))
    return step if np.max(np.abs(moves / step - np.round(moves / step))) < 0.05 and np.mean(whole == 1) > 1e-3 else 0.0


def noise_level(x: np.ndarray) -> float:
    """Noise rms of a signal: white part by its fastest differences, rounding, and never below 1e-7 of its spread."""
    return max(white_noise_level(x), quantisation_step(x) / math.sqrt(12.0), 1e-7 * float(np.std(x)))


def clear_band(spectrum: Spectrum, noise: float, dt: float) -> float:
    """Highest frequency [Hz] at which a signal stands above its noise tenfold in power.

    The density is averaged over 1/32 of the band or nine lines; noise is white with rms ``noise`` in the signal itself.
    """
    power = np.abs(spectrum.coefficient) ** 2
    level = noise**2 * 2 * dt / spectrum.duration  # mean of abs(coefficient)^2 of the odd extension of white noise
    width = min(max(9, len(power) // 32), len(power))
    smooth = np.convolve(power, np.ones(width) / width, "same")
    above = np.flatnonzero(smooth > 10 * level)
    return float(spectrum.frequency[above[-1]]) if len(above) else 0.0
