"""Hysteresis with a corner: an elasto-plastic element that unwinds straight and yields as late as n says (Bouc-Wen).

T = k d + damping d' + s z,  z' = d' - |d'| |s z / T_y|^(n-1) s z / T_y  while it winds up (d' z > 0),  z' = d' while it unwinds

n = 1 yields gradually; n large is one Maxwell-slip element: a spring of s in series with a slider of T_y.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from mjsim.effects.admissible import Range, bristles
from mjsim.effects.base import Effect, Scales, need_coupling, parameter
from mjsim.effects.hysteresis import Hysteresis
from mjsim.effects.law import RATE, STATE, law
from mjsim.effects.ports import CouplingTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["HysteresisWithCorner"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """S z; alpha = d', beta = s |d'| / T_y |s z / T_y|^(n-1) while it winds up."""
    out[0] = p[1] * z[STATE]
    out[1] = z[RATE]
    out[2] = 0.0
    if z[RATE] * z[STATE] > 0.0:
        out[2] = p[1] * abs(z[RATE]) / p[0] * (p[1] * abs(z[STATE]) / p[0]) ** (p[2] - 1.0)


@register
@dataclass(frozen=True, kw_only=True)
class HysteresisWithCorner(Effect):
    """Hysteresis with a corner; law, convention and source as in the module's text."""

    id: ClassVar[str] = "hysteresis_with_corner"
    form_of: ClassVar[str] = "hysteresis"
    places: ClassVar[tuple[str, ...]] = ("gearbox", "arm")
    sentence: ClassVar[str] = (
        "The {place} winds up along one path and unwinds along another (hysteresis): {stiffness_Nm_rad} more stiffness that yields at "
        "{torque_Nm}, with a corner of sharpness {sharpness} (1: gradual, above 10: a slider)."
    )
    citation: ClassVar[str] = "Y. K. Wen, J. Eng. Mech. 102 (1976) 249; W. D. Iwan, J. Appl. Mech. 33 (1966) 893"
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "stiffness_Nm_rad")
    family: ClassVar[str] = "coupling"
    multistart: ClassVar[int] = 3
    refines: ClassVar[tuple[str, ...]] = ("hysteresis",)

    torque_Nm: float = parameter(Quantity.TORQUE, "torque at which the element yields, link side", lower=1e-12)
    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "its stiffness before it yields, link side", lower=0.0)
    sharpness: float = parameter(Quantity.RATIO, "exponent of Bouc and Wen", lower=1.0, upper=30.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        p = (self.torque_Nm, self.stiffness_Nm_rad, self.sharpness)
        return (CouplingTorque(need_coupling(chain, self.place), torque, p, state=True),)

    def nearest(self, chain: Chain, speed: float) -> tuple[Chain, tuple[Effect, ...]]:
        """Hysteresis with the gradual corner of sharpness 1."""
        return chain, (Hysteresis(place=self.place, torque_Nm=self.torque_Nm, stiffness_Nm_rad=self.stiffness_Nm_rad),)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return bristles(self.torque_Nm, self.stiffness_Nm_rad, 8.0 * scales.deflection)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [
            {"torque_Nm": part * stiffness * scales.deflection, "stiffness_Nm_rad": stiffness, "sharpness": sharpness}
            for stiffness in (0.3 * scales.stiffness, 2.0 * scales.stiffness)
            for part in (0.2, 1.0) for sharpness in (2.0, 8.0)
        ]  # fmt: skip
