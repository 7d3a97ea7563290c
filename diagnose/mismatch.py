"""Where a model and a recording differ: in time, frequency, state and place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["Mismatch", "Place", "Share", "StateShare"]


@dataclass(frozen=True)
class Share:
    """A stretch of time [s] or a band of frequency [Hz] and its share of the residual energy above noise (0..1)."""

    low: float
    high: float
    share: float


@dataclass(frozen=True, eq=False)
class StateShare:
    """How much of the disturbance torque at the motor a function of one state explains (0..1), and that function.

    state: its name; x: bin centres in unit; y: mean disturbance torque there; error: its standard error.
    """

    state: str
    unit: str
    share: float
    x: np.ndarray
    y: np.ndarray
    error: np.ndarray


@dataclass(frozen=True)
class Place:
    """A place at which a disturbance could close the gap.

    Rms of the torque (or signal) that does, how much of it one state explains.
    """

    place: str
    element: str
    rms: float
    unit: str
    explained: float
    by: str


@dataclass(frozen=True, eq=False)
class Mismatch:
    """Where the refitted nominal model and the recording differ.

    spectrum: (frequency_hz, residual psd, noise psd, output psd) arrays; above_noise: share of the residual energy that
    is not noise;
    linear_share: share of it that is coherent with the input (the rest is nonlinear distortion or disturbance);
    source, role: the recording; energy: of its residual above noise, over the variance of the noise.
    """

    time: tuple[Share, ...]
    frequency: tuple[Share, ...]
    state: tuple[StateShare, ...]
    place: tuple[Place, ...]
    spectrum: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    above_noise: float
    linear_share: float
    source: str = ""
    role: str = "estimation"
    energy: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Intervals with their shares, as in the contract."""
        return {
            "time": [{"start_s": s.low, "end_s": s.high, "share": s.share} for s in self.time],
            "frequency": [{"low_hz": s.low, "high_hz": s.high, "share": s.share} for s in self.frequency],
            "state": [{"state": s.state, "unit": s.unit, "share": s.share} for s in self.state],
            "place": [
                {"place": p.place, "element": p.element, "rms": p.rms, "unit": p.unit, "explained": p.explained, "by": p.by}
                for p in self.place
            ],
            "above_noise": self.above_noise,
            "linear_share": self.linear_share,
        }
