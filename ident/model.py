"""A polynomial model: A(q) y = B(q)/F(q) u + C(q)/D(q) e, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ident.data import frozen
from ident.structure import Structure
from mjsim.errors import InputError

if TYPE_CHECKING:
    from control import TransferFunction

__all__ = ["PolyModel"]


def _response(poly: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Polynomial in q^-1 on the unit circle at w [rad/sample]."""
    values: np.ndarray = np.exp(-1j * np.outer(w, np.arange(poly.size))) @ poly
    return values


@dataclass(frozen=True)
class PolyModel:
    """A polynomial model (MATLAB ``idpoly``).

    A, C, D, F: monic, shape (order + 1,), rising powers of q^-1. B: shape (nb,), its first coefficient belongs to q^-nk.
    noise_variance: variance of e [output unit squared]. covariance: of [a, b, c, d, f], shape (n, n), or None when the model
    was not estimated. dt: sampling interval [s].
    """

    structure: Structure
    dt: float
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    F: np.ndarray
    noise_variance: float = 0.0
    covariance: np.ndarray | None = None

    def __post_init__(self) -> None:
        s = self.structure
        for name, size in (("A", s.na + 1), ("B", s.nb), ("C", s.nc + 1), ("D", s.nd + 1), ("F", s.nf + 1)):
            array = frozen(getattr(self, name))
            if array.shape != (size,) or not np.all(np.isfinite(array)):
                raise InputError(f"polynomial {name}", f"shape {array.shape}", f"{size} finite coefficients for {s}")
            if name != "B" and array[0] != 1.0:
                raise InputError(f"polynomial {name}", f"first coefficient {array[0]}", "1 (monic)")
            object.__setattr__(self, name, array)
        if self.covariance is not None:
            covariance = frozen(self.covariance)
            if covariance.shape != (s.n_parameters, s.n_parameters):
                raise InputError("covariance", f"shape {covariance.shape}", f"({s.n_parameters}, {s.n_parameters})")
            object.__setattr__(self, "covariance", covariance)
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise InputError("model", f"sampling interval {self.dt}", "a positive number of seconds")

    @classmethod
    def from_theta(
        cls, structure: Structure, theta: ArrayLike, dt: float, noise_variance: float = 0.0, covariance: np.ndarray | None = None
    ) -> PolyModel:
        """From theta = [a, b, c, d, f] without the leading ones."""
        a, b, c, d, f = structure_split(structure, np.asarray(theta, float))
        return cls(structure, dt, np.r_[1, a], b, np.r_[1, c], np.r_[1, d], np.r_[1, f], noise_variance, covariance)

    @property
    def theta(self) -> np.ndarray:
        """[a, b, c, d, f] without the leading ones, shape (n,)."""
        theta: np.ndarray = np.r_[self.A[1:], self.B, self.C[1:], self.D[1:], self.F[1:]]
        return theta

    @property
    def std(self) -> dict[str, np.ndarray]:
        """Standard errors per polynomial; zero for a leading one, NaN when there is no covariance."""
        s = self.structure
        n = s.n_parameters
        std = np.full(n, np.nan) if self.covariance is None else np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        a, b, c, d, f = structure_split(s, std)
        return {"A": np.r_[0, a], "B": b, "C": np.r_[0, c], "D": np.r_[0, d], "F": np.r_[0, f]}

    @property
    def poles(self) -> np.ndarray:
        """Poles of G in the z plane."""
        return np.roots(np.polymul(self.A, self.F))

    @property
    def zeros(self) -> np.ndarray:
        """Zeros of G in the z plane, those at the origin from delays left out."""
        return np.roots(self.B)

    @property
    def stable(self) -> bool:
        """Whether every pole of G lies inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0))

    def frequency_response(self, frequency_hz: ArrayLike) -> np.ndarray:
        """G at the frequencies [Hz], complex, shape (K,), output unit over input unit."""
        w = 2 * np.pi * np.atleast_1d(np.asarray(frequency_hz, float)) * self.dt
        values: np.ndarray = (
            _response(self.B, w) * np.exp(-1j * w * self.structure.nk) / (_response(self.A, w) * _response(self.F, w))
        )
        return values

    def noise_response(self, frequency_hz: ArrayLike) -> np.ndarray:
        """H at the frequencies [Hz], complex, shape (K,)."""
        w = 2 * np.pi * np.atleast_1d(np.asarray(frequency_hz, float)) * self.dt
        values: np.ndarray = _response(self.C, w) / (_response(self.A, w) * _response(self.D, w))
        return values

    def response_gradient(self, frequency_hz: ArrayLike) -> np.ndarray:
        """dG/dtheta at the frequencies [Hz], complex, shape (K, n); zero for C and D."""
        s = self.structure
        w = 2 * np.pi * np.atleast_1d(np.asarray(frequency_hz, float)) * self.dt
        a, f = _response(self.A, w)[:, None], _response(self.F, w)[:, None]
        g = self.frequency_response(frequency_hz)[:, None]

        def powers(first: int, count: int) -> np.ndarray:
            delays: np.ndarray = np.exp(-1j * np.outer(w, first + np.arange(count)))
            return delays

        silent = np.zeros((w.size, s.nc + s.nd))
        return np.hstack([-g / a * powers(1, s.na), powers(s.nk, s.nb) / (a * f), silent, -g / f * powers(1, s.nf)])

    def simulate(self, u: ArrayLike, noise: ArrayLike | None = None) -> np.ndarray:
        """Output from rest for input u, shape (N,); ``noise`` is the white sequence e, if any. MATLAB ``sim``."""
        from scipy.signal import lfilter

        u = np.asarray(u, float)
        y: np.ndarray = lfilter(np.r_[np.zeros(self.structure.nk), self.B], np.polymul(self.A, self.F), u)
        if noise is not None:
            y = y + lfilter(self.C, np.polymul(self.A, self.D), np.asarray(noise, float))
        return y

    def to_control(self) -> TransferFunction:
        """G as a discrete ``control.TransferFunction`` in z."""
        import control

        s = self.structure
        num, den = np.r_[np.zeros(s.nk), self.B], np.polymul(self.A, self.F)
        size = max(num.size, den.size)
        num, den = np.pad(num, (0, size - num.size)), np.pad(den, (0, size - den.size))
        return control.TransferFunction(np.trim_zeros(num, "f"), den, self.dt)

    def noise_to_control(self) -> TransferFunction:
        """H as a discrete ``control.TransferFunction`` in z."""
        import control

        num, den = self.C, np.polymul(self.A, self.D)
        size = max(num.size, den.size)
        return control.TransferFunction(np.pad(num, (0, size - num.size)), np.pad(den, (0, size - den.size)), self.dt)

    @classmethod
    def from_control(cls, system: Any, noise_variance: float = 0.0) -> PolyModel:
        """An output-error model from a discrete single-channel ``control`` system (transfer function or state space).

        Coefficients below 1e-12 of the largest are what a conversion from state space left by rounding: they count as zero, so
        that the delay nk comes back. Raises InputError for more channels, no definite dt, or a numerator of higher degree.
        """
        import control

        tf = control.tf(system)
        if tf.ninputs != 1 or tf.noutputs != 1:
            raise InputError("control system", f"{tf.ninputs} inputs and {tf.noutputs} outputs", "one of each")
        if not tf.isdtime(strict=True) or tf.dt is True:
            raise InputError(
                "control system", f"dt = {tf.dt}", "a discrete system with its sampling interval", "use control.sample_system"
            )
        num, den = np.asarray(tf.num[0][0], float), np.asarray(tf.den[0][0], float)
        num, den = (np.where(np.abs(p) > 1e-12 * np.max(np.abs(p)), p, 0.0) / den[0] for p in (num, den))
        if np.trim_zeros(num, "f").size > den.size:
            raise InputError("control system", "a numerator of higher degree than the denominator", "a causal system")
        delay = den.size - np.trim_zeros(num, "f").size
        b = np.trim_zeros(num, "f")
        nb = max(1, np.trim_zeros(b, "b").size)
        nf = np.trim_zeros(den, "b").size - 1
        structure = Structure.oe(nb, nf, delay)
        ones = np.ones(1)
        return cls(structure, float(tf.dt), ones, b[:nb] if b.size else np.zeros(1), ones, ones, den[: nf + 1], noise_variance)


def structure_split(s: Structure, theta: np.ndarray) -> list[np.ndarray]:
    """[a, b, c, d, f] as five arrays."""
    return np.split(theta[: s.n_parameters], np.cumsum([s.na, s.nb, s.nc, s.nd]))
