"""Test systems with known truth: the three-mass axis of the study and two classics of the textbooks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter, ss2tf

__all__ = ["SYSTEMS", "System", "axis_matrices"]


def axis_matrices() -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """State space of the axis, torque [Nm] to motor velocity [rad/s]; states wm, wg, wa, r*thm - thg, thg - tha."""
    jm, jg, ja, fm, kg, ka, dg, da, r = 4.56e-4, 9.92, 1.72, 3.55e-2, 1.50e5, 0.446e5, -62.0, 20.0, 1 / 118
    a = np.array(
        [
            [-(fm + r * dg * r) / jm, r * dg / jm, 0.0, -r * kg / jm, 0.0],
            [dg * r / jg, -(dg + da) / jg, da / jg, kg / jg, -ka / jg],
            [0.0, da / ja, -da / ja, 0.0, ka / ja],
            [r, -1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, -1.0, 0.0, 0.0],
        ]
    )
    return a, np.array([[1 / jm], [0], [0], [0], [0]]), np.array([[1.0, 0, 0, 0, 0]]), np.zeros((1, 1))


@dataclass(frozen=True)
class System:
    """``y = B/F u + C/D e`` with the noise at ``noise_to_signal`` times the output's standard deviation."""

    name: str
    dt: float
    B: NDArray  # from q^-1 on
    C: NDArray
    D: NDArray
    F: NDArray
    orders: tuple[int, int, int, int, int]
    noise_to_signal: float

    def record(self, seed: int, n: int) -> tuple[NDArray, NDArray, float]:
        """Input (random binary, the same for every seed), output and the noise's standard deviation."""
        u = np.where(np.random.default_rng(4242).standard_normal(n) > 0, 1.0, -1.0)
        y0 = lfilter(np.r_[0.0, self.B], self.F, u)
        probe = lfilter(self.C, self.D, np.random.default_rng(7).standard_normal(20000))
        sigma = self.noise_to_signal * float(np.std(y0)) / float(np.std(probe))
        e = sigma * np.random.default_rng(100_000 + seed).standard_normal(n)
        return u, y0 + lfilter(self.C, self.D, e), sigma

    def response(self, w: NDArray) -> NDArray:
        """G at w [rad/sample]."""
        z = np.exp(-1j * w)
        return z * np.polyval(self.B[::-1], z) / np.polyval(self.F[::-1], z)


def _pairs(*polar: tuple[float, float], real: float) -> NDArray:
    roots = [r * np.exp(s * 1j * w) for r, w in polar for s in (1, -1)]
    return np.real(np.poly([*roots, real]))


def _axis() -> System:
    a, b, c, d, _ = cont2discrete(axis_matrices(), 0.005)
    num, den = ss2tf(a, b, c, d)
    noise = _pairs((0.8, 1.0), (0.5, 2.0), real=-0.4), _pairs((0.9, 0.5), (0.7, 1.5), real=0.8)
    return System("axis", 0.005, num[0][1:], *noise, den, (5, 5, 5, 5, 1), 0.1)


_B, _C, _F = np.array([1.0, 0.5]), np.array([1, -1.0, 0.2]), np.array([1, -1.5, 0.7])
SYSTEMS = {
    s.name: s
    for s in (
        _axis(),
        # Box-Jenkins example of MATLAB's System Identification Toolbox manual (Ljung)
        System("ljung", 1.0, _B, _C, np.array([1, 1.5, 0.7]), _F, (2, 2, 2, 2, 1), 0.5),
        # Astrom's ARMAX system (Soderstrom & Stoica), fitted as Box-Jenkins: F = D
        System("astrom", 1.0, _B, _C, _F, _F, (2, 2, 2, 2, 1), 0.5),
    )
}
