"""Frequency response with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ident.data import frozen
from ident.model import PolyModel
from mjsim.errors import InputError

__all__ = ["Bode", "Extremum", "bode"]


@dataclass(frozen=True)
class Extremum:
    """A peak or a notch of the magnitude: ``kind`` is ``peak`` or ``notch``."""

    kind: str
    frequency_hz: float
    magnitude_db: float


@dataclass(frozen=True)
class Bode:
    """G at K frequencies [Hz], with standard errors of its magnitude and phase.

    response: complex (K,). magnitude_std: relative standard error of abs(G), (K,). phase_std_deg: [deg], (K,). Both come from the
    parameter covariance P by the delta method: with g = (dG/dtheta)/G, var(ln abs G) = Re(g) P Re(g)', var(arg G) = Im(g) P
    Im(g)'. Zero when the model has no covariance.
    """

    frequency_hz: np.ndarray
    response: np.ndarray
    magnitude_std: np.ndarray
    phase_std_deg: np.ndarray

    def __post_init__(self) -> None:
        for name in ("frequency_hz", "magnitude_std", "phase_std_deg"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "response", frozen(self.response, complex))

    @property
    def magnitude_db(self) -> np.ndarray:
        """20 log10 abs(G) [dB], (K,)."""
        level: np.ndarray = 20 * np.log10(np.maximum(np.abs(self.response), 1e-300))
        return level

    @property
    def phase_deg(self) -> np.ndarray:
        """Phase [deg], unwrapped and starting within (-180, 180], (K,)."""
        phase: np.ndarray = np.degrees(np.unwrap(np.angle(self.response)))
        return phase

    def magnitude_db_interval(self, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper edge of the magnitude's confidence band [dB], pointwise."""
        half = _quantile(level) * 20 / np.log(10) * self.magnitude_std
        return self.magnitude_db - half, self.magnitude_db + half

    def phase_deg_interval(self, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper edge of the phase's confidence band [deg], pointwise."""
        half = _quantile(level) * self.phase_std_deg
        return self.phase_deg - half, self.phase_deg + half

    def extrema(self, prominence_db: float = 1.0) -> tuple[Extremum, ...]:
        """Peaks and notches that stand out by ``prominence_db``, by rising frequency; parabolic refinement on a log axis."""
        from scipy.signal import find_peaks

        found = []
        m, x = self.magnitude_db, np.log(self.frequency_hz)
        for kind, sign in (("peak", 1.0), ("notch", -1.0)):
            for i in find_peaks(sign * m, prominence=prominence_db)[0]:
                c = np.polyfit(x[i - 1 : i + 2] - x[i], m[i - 1 : i + 2], 2)
                shift = -c[1] / (2 * c[0]) if c[0] != 0 else 0.0
                found.append(Extremum(kind, float(np.exp(x[i] + shift)), float(np.polyval(c, shift))))
        return tuple(sorted(found, key=lambda e: e.frequency_hz))


def _quantile(level: float) -> float:
    from scipy.special import ndtri

    if not 0.0 < level < 1.0:
        raise InputError("confidence level", f"{level}", "a number between 0 and 1")
    return float(ndtri(0.5 + level / 2))


def default_frequencies(dt: float, points: int = 400, low_hz: float | None = None) -> np.ndarray:
    """``points`` frequencies [Hz] on a log grid up to Nyquist, over three decades or from ``low_hz`` if that is lower."""
    top = 0.5 / dt
    low = top * 1e-3 if low_hz is None or low_hz <= 0 else min(top * 1e-3, low_hz)
    return np.geomspace(low, top * (1 - 1e-9), points)


def bode(model: PolyModel, frequency_hz: ArrayLike | None = None) -> Bode:
    """Frequency response of G with standard errors (MATLAB ``bode(sys)`` with ``showConfidence``)."""
    f = default_frequencies(model.dt) if frequency_hz is None else np.atleast_1d(np.asarray(frequency_hz, float))
    if np.any(f < 0) or np.any(f > 0.5 / model.dt * (1 + 1e-9)):
        raise InputError("frequencies", f"{f.min():g} to {f.max():g} Hz", f"0 to the Nyquist frequency {0.5 / model.dt:g} Hz")
    response = model.frequency_response(f)
    if model.covariance is None:
        return Bode(f, response, np.zeros(f.size), np.zeros(f.size))
    g = model.response_gradient(f) / response[:, None]
    real = np.einsum("ki,ij,kj->k", g.real, model.covariance, g.real)
    imag = np.einsum("ki,ij,kj->k", g.imag, model.covariance, g.imag)
    return Bode(f, response, np.sqrt(np.maximum(real, 0)), np.degrees(np.sqrt(np.maximum(imag, 0))))
