"""The shared filter: decimation and low-pass, put on input and output alike so that their ratio stays.

==========================  =====================================================  ==========================================
here                        what                                                   MATLAB
==========================  =====================================================  ==========================================
``Decimation(10)``          Chebyshev I order 8, 0.05 dB, edge 0.8/10 of Nyquist,  ``decimate(x, 10)``
                            forward and backward (zero phase)
``Decimation(.., CAUSAL)``  the same filter, forward only                          ``filter`` + ``downsample``
``Decimation(.., design=    Butterworth order 8, edge 0.8/10 of Nyquist            ``filtfilt(butter(8, .8/10))`` + ``downsample``
BUTTERWORTH)``
``LowPass(8, 0.4)``         Butterworth order 8, cut-off 0.4 of Nyquist, causal    ``idfilt(data, 8, 0.4)``
``LowPass(.., ZERO_PHASE)`` the same, forward and backward                         ``idfilt(data, 8, 0.4, 'noncausal')``
==========================  =====================================================  ==========================================

Order of the two: 2000 Hz is decimated by ten first, to 5 ms; the low-pass edge is 0.4 of the *new* Nyquist frequency of 628
rad/s, that is 251 rad/s = 40 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from ident.data import IOData
from mjsim.errors import InputError

if TYPE_CHECKING:
    import numpy as np

__all__ = ["Decimation", "Design", "LowPass", "Phase", "decimate", "low_pass", "shared_filter"]


class Phase(Enum):
    """Whether a filter looks into the future."""

    CAUSAL = "causal"
    ZERO_PHASE = "zero-phase"


class Design(Enum):
    """Family of the anti-alias filter."""

    BUTTERWORTH = "butterworth"
    CHEBYSHEV = "chebyshev"


@dataclass(frozen=True)
class LowPass:
    """Butterworth low-pass of ``order`` with its -3 dB point at ``fraction`` of the Nyquist frequency."""

    order: int = 8
    fraction: float = 0.4
    phase: Phase = Phase.CAUSAL

    def __post_init__(self) -> None:
        if not 1 <= self.order <= 20:
            raise InputError("low-pass order", f"{self.order}", "1 to 20")
        if not 0.0 < self.fraction < 1.0:
            raise InputError("cut-off", f"{self.fraction:g} of Nyquist", "a fraction between 0 and 1")

    def sections(self) -> np.ndarray:
        """Second-order sections."""
        from scipy.signal import butter

        sections: np.ndarray = butter(self.order, self.fraction, output="sos")
        return sections


@dataclass(frozen=True)
class Decimation:
    """Keep every ``factor``-th sample after an anti-alias filter with its edge at 0.8 of the new Nyquist frequency."""

    factor: int = 10
    design: Design = Design.CHEBYSHEV
    phase: Phase = Phase.ZERO_PHASE
    order: int = 8
    ripple_db: float = 0.05

    def __post_init__(self) -> None:
        if not 1 <= self.factor <= 1000:
            raise InputError("decimation", f"{self.factor}", "a whole number from 1 (none) to 1000")
        if not 1 <= self.order <= 20:
            raise InputError("anti-alias order", f"{self.order}", "1 to 20")

    def sections(self) -> np.ndarray:
        """Second-order sections."""
        from scipy.signal import butter, cheby1

        edge = 0.8 / self.factor
        if self.design is Design.CHEBYSHEV:
            sections: np.ndarray = cheby1(self.order, self.ripple_db, edge, output="sos")
        else:
            sections = butter(self.order, edge, output="sos")
        return sections


def _apply(sections: np.ndarray, x: np.ndarray, phase: Phase, source: str) -> np.ndarray:
    from scipy.signal import sosfilt, sosfiltfilt

    if phase is Phase.CAUSAL:
        forward: np.ndarray = sosfilt(sections, x)
        return forward
    pad = 3 * (2 * len(sections) + 1)
    if x.size <= pad:
        raise InputError(
            source, f"{x.size} samples", f"more than {pad} for a zero-phase filter", "record longer or filter causally"
        )
    both_ways: np.ndarray = sosfiltfilt(sections, x)
    return both_ways


def low_pass(data: IOData, filter_: LowPass | None = None) -> IOData:
    """Both channels through the same low-pass, from rest."""
    f = filter_ or LowPass()
    s = f.sections()
    return data.with_signals(_apply(s, data.u, f.phase, data.source), _apply(s, data.y, f.phase, data.source))


def decimate(data: IOData, decimation: Decimation | None = None) -> IOData:
    """Both channels through the same anti-alias filter, then every ``factor``-th sample from the first on; dt grows by the
    factor."""
    d = decimation or Decimation()
    if d.factor == 1:
        return data
    s = d.sections()
    u, y = (_apply(s, x, d.phase, data.source)[:: d.factor] for x in (data.u, data.y))
    return replace(data.with_signals(u, y, data.dt * d.factor), every=data.every * d.factor)


def shared_filter(
    data: IOData, decimation: Decimation | None = None, low: LowPass | None = None, *, filtered: bool = True
) -> IOData:
    """The study's pipeline: decimate, then low-pass at a fraction of the new Nyquist frequency (``filtered=False``: decimate
    only)."""
    data = decimate(data, decimation)
    return low_pass(data, low) if filtered else data
