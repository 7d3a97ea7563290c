"""Nonparametric frequency responses: the check on every parametric model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.data import IOData, frozen
from mjsim.errors import InputError
from mjsim.signals import transforms

__all__ = ["SpectralEstimate", "etfe", "spectral"]


@dataclass(frozen=True)
class SpectralEstimate:
    """Frequency response at K frequencies [Hz].

    response: complex (K,). coherence: (K,), 0 to 1; 1 where nothing but u explains y linearly (NaN for an unsmoothed estimate).
    noise_spectrum: (K,), power of what u does not explain [output unit^2 s]. relative_std: standard error of abs(G)/abs(G), (K,).
    """

    frequency_hz: np.ndarray
    response: np.ndarray
    coherence: np.ndarray
    noise_spectrum: np.ndarray
    relative_std: np.ndarray

    def __post_init__(self) -> None:
        for name in ("frequency_hz", "coherence", "noise_spectrum", "relative_std"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "response", frozen(self.response, complex))

    @property
    def magnitude_db(self) -> np.ndarray:
        """20 log10 abs(G) [dB]."""
        level: np.ndarray = 20 * np.log10(np.maximum(np.abs(self.response), 1e-300))
        return level

    @property
    def phase_deg(self) -> np.ndarray:
        """Phase [deg], in (-180, 180]."""
        phase: np.ndarray = np.degrees(np.angle(self.response))
        return phase


def etfe(data: IOData, floor: float = 1e-3) -> SpectralEstimate:
    """Empirical transfer function estimate ``Y(f)/U(f)`` at the lines where abs(U) exceeds ``floor`` of its largest (MATLAB
    ``etfe``)."""
    u, y = np.fft.rfft(data.u), np.fft.rfft(data.y)
    f = np.fft.rfftfreq(len(data), data.dt)
    size = np.abs(u)
    keep = (size > floor * size.max()) & (f > 0)
    nothing = np.full(int(keep.sum()), np.nan)
    return SpectralEstimate(f[keep], y[keep] / u[keep], nothing, nothing, nothing)


def spectral(data: IOData, window: int | None = None) -> SpectralEstimate:
    """Smoothed estimate ``Pyu / Pu`` with coherence (MATLAB ``spa``), by overlapping Hann-windowed segments (Welch).

    ``window``: segment length in samples; default such that at least eight segments with half overlap fit (at most 8192).
    The relative standard error is ``sqrt((1 - c) / (2 c m))`` with coherence c and m effective segments (Bendat & Piersol).
    """
    n = len(data)
    if window is None:
        window = min(8192, 2 ** int(np.log2(max(16, n // 6))))
    if not 8 <= window <= n // 2:
        raise InputError("spectral window", f"{window} samples", f"8 to half of the {n} samples")
    f, U = transforms(data.u, data.dt, window)
    _, Y = transforms(data.y, data.dt, window)
    pu, py = (np.mean(np.abs(X) ** 2, axis=0) for X in (U, Y))
    puy = np.mean(np.conj(U) * Y, axis=0)
    keep = (f > 0) & (pu > 1e-12 * pu.max())
    c = np.clip(np.abs(puy[keep]) ** 2 / (pu[keep] * np.maximum(py[keep], 1e-300)), 1e-12, 1.0)
    segments = max(1.0, (2 * n / window - 1) * 0.95 * 9 / 11)
    std = np.sqrt((1 - c) / (2 * c * segments))
    return SpectralEstimate(f[keep], puy[keep] / pu[keep], c, py[keep] * (1 - c), std)
