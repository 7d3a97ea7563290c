"""Sampled data of one input and one output."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mjsim.errors import InputError

if TYPE_CHECKING:
    from mjsim.recording import Recording

__all__ = ["Detrend", "IOData", "frozen"]


def frozen(values: ArrayLike, dtype: type = float) -> np.ndarray:
    """A read-only contiguous copy."""
    array: np.ndarray = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


class Detrend(Enum):
    """What is taken off both channels (MATLAB ``detrend(data, 0)`` and ``detrend(data, 1)``)."""

    NONE = "none"
    MEAN = "mean"
    LINEAR = "linear"


_SUFFIXES = (
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_Nm", "Nm"),
    ("_N", "N"),
    ("_rad", "rad"),
    ("_deg", "deg"),
    ("_m", "m"),
    ("_V", "V"),
    ("_A", "A"),
)
"""How a column's name ends -> its unit."""


@dataclass(frozen=True)
class IOData:
    """Input u and output y, both of shape (N,), sampled every dt seconds; MATLAB ``iddata(y, u, dt)``.

    every: one sample here stands for so many of the recording (a message about N samples says so).

    Raises InputError for channels of unequal length, samples that are missing (NaN) or infinite, and a dt that is not positive.
    """

    u: np.ndarray
    y: np.ndarray
    dt: float
    u_name: str = "u"
    y_name: str = "y"
    u_unit: str = ""
    y_unit: str = ""
    source: str = "data"
    every: int = 1

    def __post_init__(self) -> None:
        for name in ("u", "y"):
            try:
                array = frozen(getattr(self, name))
            except (TypeError, ValueError):
                raise InputError(self.source, f"{self._label(name)} is not numeric", "an array of numbers") from None
            if array.ndim != 1:
                raise InputError(self.source, f"{self._label(name)} has shape {array.shape}", "one channel, shape (N,)")
            bad = np.flatnonzero(~np.isfinite(array))
            if bad.size:
                raise InputError(
                    self.source,
                    f"{self._label(name)} is missing or not finite at {bad.size} samples, the first at sample {bad[0]}",
                    "finite numbers",
                    "cut the record there or fill the gap",
                )
            object.__setattr__(self, name, array)
        if self.u.size != self.y.size:
            raise InputError(self.source, f"{self.u.size} input and {self.y.size} output samples", "equal numbers")
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise InputError(self.source, f"sampling interval {self.dt} s", "a positive number of seconds")

    @classmethod
    def from_recording(cls, recording: Recording, input_name: str | None = None, output_name: str | None = None) -> IOData:
        """Two channels of a recording, in SI as it holds them.

        input_name, output_name: a role (``torque``, ``velocity``, ``angle``, ...) or a column of the file, as it stands there;
        default: the torque, and the velocity where there is one, else the angle. Raises InputError, which lists the columns, for
        one that is not there, and for missing samples.
        """
        into = input_name or "torque"
        out = output_name or ("velocity" if recording.velocity is not None else "angle")

        def unit(name: str) -> str:
            return recording.units.get(name) or next((u for suffix, u in _SUFFIXES if name.endswith(suffix)), "")

        return cls(
            recording.column(into), recording.column(out), recording.dt, into, out, unit(into), unit(out), recording.source
        )

    def _label(self, name: str) -> str:
        return f"{'input' if name == 'u' else 'output'} {getattr(self, name + '_name')}"

    def __len__(self) -> int:
        return int(self.u.size)

    @property
    def time(self) -> np.ndarray:
        """Sample times [s], shape (N,), from zero."""
        return np.arange(len(self)) * self.dt

    @property
    def nyquist_hz(self) -> float:
        """Half the sampling frequency [Hz]."""
        return 0.5 / self.dt

    def part(self, start: int, stop: int) -> IOData:
        """Samples start to stop - 1."""
        return replace(self, u=self.u[start:stop], y=self.y[start:stop])

    def with_signals(self, u: ArrayLike, y: ArrayLike, dt: float | None = None) -> IOData:
        """The same names and units around other samples."""
        return replace(self, u=np.asarray(u), y=np.asarray(y), dt=self.dt if dt is None else dt)

    def detrended(self, kind: Detrend = Detrend.MEAN) -> IOData:
        """Both channels without their mean or their straight line."""
        if kind is Detrend.NONE:
            return self
        from scipy.signal import detrend

        how = "constant" if kind is Detrend.MEAN else "linear"
        return self.with_signals(detrend(self.u, type=how), detrend(self.y, type=how))
