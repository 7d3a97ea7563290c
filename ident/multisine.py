"""Random-phase multisines with odd lines, some of them left out as detection lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.data import frozen
from mjsim.errors import InputError

__all__ = ["Multisine", "odd_multisine"]


@dataclass(frozen=True)
class Multisine:
    """One period of a multisine.

    period: samples. excited, odd_detection, even_detection: line numbers (multiples of 1 / (period dt)). signal: (period,).
    """

    period: int
    dt: float
    excited: np.ndarray
    odd_detection: np.ndarray
    even_detection: np.ndarray
    signal: np.ndarray

    def __post_init__(self) -> None:
        for name in ("excited", "odd_detection", "even_detection"):
            object.__setattr__(self, name, frozen(getattr(self, name), int))
        object.__setattr__(self, "signal", frozen(self.signal))

    def repeated(self, periods: int) -> np.ndarray:
        """The signal ``periods`` times over."""
        return np.tile(self.signal, periods)


def odd_multisine(
    period: int, dt: float, band_hz: tuple[float, float], rms: float, rng: np.random.Generator, group: int = 4
) -> Multisine:
    """An odd random-phase multisine: of each ``group`` odd lines in the band one, drawn at random, is left out to detect.

    Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., section 4.3. An even nonlinearity puts
    power on even lines, an odd one on the odd lines left out; a linear system puts none on either.
    """
    first, last = (round(f * period * dt) for f in band_hz)
    odd = np.arange(first | 1, last + 1, 2)
    if odd.size < 2 * group or last >= period // 2:
        raise InputError(
            "multisine",
            f"{odd.size} odd lines in {band_hz[0]:g}-{band_hz[1]:g} Hz",
            f"at least {2 * group} below Nyquist",
            "a longer period",
        )
    skipped = np.array([rng.choice(odd[i : i + group]) for i in range(0, odd.size - group + 1, group)])
    excited = np.setdiff1d(odd, skipped)
    spectrum = np.zeros(period // 2 + 1, complex)
    spectrum[excited] = np.exp(2j * np.pi * rng.random(excited.size))
    signal = np.fft.irfft(spectrum, period)
    signal *= rms / np.sqrt(np.mean(signal**2))
    even = np.arange(max(2, first + first % 2), last + 1, 2)
    return Multisine(period, dt, excited, skipped, even, signal)
