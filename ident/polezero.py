"""Poles and zeros of the plant with confidence ellipses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.data import frozen
from ident.model import PolyModel

__all__ = ["PoleZero", "Root", "pole_zero"]


@dataclass(frozen=True)
class Root:
    """A root z with the covariance (2, 2) of its real and imaginary part.

    frequency_hz, damping: natural frequency [Hz] and damping ratio of ``s = ln(z) / dt`` (MATLAB ``damp``), with their standard
    errors frequency_std_hz [Hz] and damping_std by the delta method (zero without a covariance).
    """

    z: complex
    covariance: np.ndarray
    frequency_hz: float
    damping: float
    frequency_std_hz: float = 0.0
    damping_std: float = 0.0

    def ellipse(self, level: float = 0.95, points: int = 73) -> np.ndarray:
        """Outline of the confidence region, complex (points,): chi-square with two degrees of freedom (one for a real root)."""
        from scipy.stats import chi2

        values, vectors = np.linalg.eigh(self.covariance)
        real = abs(self.z.imag) < 1e-12
        radius = np.sqrt(chi2.ppf(level, 1 if real else 2) * np.maximum(values, 0.0))
        turn = np.linspace(0, 2 * np.pi, points)
        outline = vectors @ (radius[:, None] * np.array([np.cos(turn), np.sin(turn)]))
        border: np.ndarray = self.z + outline[0] + 1j * outline[1]
        return border


@dataclass(frozen=True)
class PoleZero:
    """Poles and zeros of G."""

    poles: tuple[Root, ...]
    zeros: tuple[Root, ...]
    dt: float


def _roots(poly: np.ndarray, covariance: np.ndarray | None, monic: bool, dt: float) -> tuple[Root, ...]:
    """First-order error propagation: ``dz/dp_i = -z^(n-i) / P'(z)`` for the coefficient p_i of z^(n-i)."""
    roots = np.roots(poly)
    n = poly.size - 1
    slope = np.polyder(poly)
    out = []
    for z in roots:
        spread = np.zeros((2, 2))
        if covariance is not None and covariance.size:
            index = np.arange(1 if monic else 0, n + 1)
            denominator = np.polyval(slope, z)
            if abs(denominator) > 1e-12:
                g = -(z ** (n - index)) / denominator
                real = np.stack([g.real, g.imag])
                spread = real @ covariance @ real.T
        s = np.log(complex(z)) / dt if z != 0 else complex(-np.inf)
        size = abs(s)
        if not 0 < size < np.inf:
            out.append(Root(complex(z), frozen(spread), float(size / 2 / np.pi), 1.0))
            continue
        # d s = d z / (z dt); with s = x + i w: d abs(s) = (x dx + w dw) / abs(s), d zeta = -dx / abs(s) + x d abs(s) / abs(s)^2
        turn = 1.0 / (complex(z) * dt)
        move = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]]) @ spread
        move = move @ np.array([[turn.real, -turn.imag], [turn.imag, turn.real]]).T
        d_size = np.array([s.real, s.imag]) / size
        d_damping = np.array([-1.0 / size, 0.0]) + s.real / size**2 * d_size
        out.append(
            Root(
                complex(z),
                frozen(spread),
                float(size / 2 / np.pi),
                float(-s.real / size),
                float(np.sqrt(max(d_size @ move @ d_size, 0.0)) / 2 / np.pi),
                float(np.sqrt(max(d_damping @ move @ d_damping, 0.0))),
            )
        )
    return tuple(sorted(out, key=lambda r: (r.frequency_hz, r.z.imag)))


def pole_zero(model: PolyModel) -> PoleZero:
    """Poles (of A and F) and zeros (of B) with their uncertainty (MATLAB ``iopzplot`` with ``showConfidence``)."""
    s, p = model.structure, model.covariance

    def block(first: int, count: int) -> np.ndarray | None:
        return None if p is None else p[first : first + count, first : first + count]

    poles = _roots(model.A, block(0, s.na), True, model.dt) + _roots(
        model.F, block(s.na + s.nb + s.nc + s.nd, s.nf), True, model.dt
    )
    return PoleZero(poles, _roots(model.B, block(s.na, s.nb), False, model.dt), model.dt)
