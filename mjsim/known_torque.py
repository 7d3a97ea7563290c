"""A torque on the driven body that is known sample by sample, as gravity and coupling forces by another model.

tau(t): straight lines between the samples; it runs like an effect and stands on no registry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from mjsim.effects.base import Effect, Scales
from mjsim.effects.law import TIME, law
from mjsim.effects.ports import BodyTorque, Port

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["KnownTorque"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """p[0]: sample time, p[1]: number of samples, p[2:]: the samples."""
    at = z[TIME] / p[0]
    k = int(at)
    last = int(p[1]) - 1
    if at <= 0.0:
        out[0] = p[2]
    elif k >= last:
        out[0] = p[2 + last]
    else:
        out[0] = p[2 + k] + (at - k) * (p[3 + k] - p[2 + k])


@dataclass(frozen=True, kw_only=True)
class KnownTorque(Effect):
    """The torque as an effect without parameters; ``table``: sample time, number of samples, samples."""

    id: ClassVar[str] = "known_torque"
    places: ClassVar[tuple[str, ...]] = ("motor",)
    sentence: ClassVar[str] = "A torque that is known sample by sample."
    citation: ClassVar[str] = ""

    table: tuple[float, ...] = ()

    @classmethod
    def of(cls, values: np.ndarray, dt: float) -> Self:
        """The torque of samples (N,) [N m | N] that are dt [s] apart."""
        return cls(table=(dt, float(len(values)), *map(float, values)))

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """On body 0."""
        return (BodyTorque(0, torque, self.table, timed=True),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """None: nothing of it is fitted."""
        return []
