"""Hysteresis: an elasto-plastic element beside the spring (Bouc-Wen with n = 1; the limit of a Maxwell-slip bank).

T = k d + damping d' + s z,  z' = d' - s |d'| z / T_y
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mjsim.effects.admissible import Range, bristles
from mjsim.effects.base import Effect, Scales, need_coupling, parameter
from mjsim.effects.law import RATE, STATE, law
from mjsim.effects.native import CouplingBristle, Native, Value
from mjsim.effects.ports import CouplingTorque, Port
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["Hysteresis"]


@law
def torque(z: Any, p: Any, out: Any) -> None:
    """S z; alpha = d', beta = s |d'| / T_y."""
    out[0] = p[1] * z[STATE]
    out[1] = z[RATE]
    out[2] = p[1] * abs(z[RATE]) / p[0]


@register
@dataclass(frozen=True, kw_only=True)
class Hysteresis(Effect):
    """Hysteresis; law, convention and source as in the module's text."""

    id: ClassVar[str] = "hysteresis"
    places: ClassVar[tuple[str, ...]] = ("gearbox", "arm")
    sentence: ClassVar[str] = (
        "The {place} winds up along one path and unwinds along another (hysteresis): {stiffness_Nm_rad} more stiffness that yields at {torque_Nm}."
    )
    citation: ClassVar[str] = (
        "R. Bouc 1967; Y. K. Wen, J. Eng. Mech. 102 (1976) 249; Ruderman, Hoffmann, Bertram, IEEE Trans. Ind. El. 56 (2009) 3840"
    )
    tolerance: ClassVar[float] = 1e-3
    amplitudes: ClassVar[tuple[str, ...]] = ("torque_Nm", "stiffness_Nm_rad")
    family: ClassVar[str] = "coupling"
    multistart: ClassVar[int] = 3

    torque_Nm: float = parameter(Quantity.TORQUE, "torque at which the element yields, link side", lower=1e-12)
    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "its stiffness before it yields, link side", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        return (CouplingTorque(need_coupling(chain, self.place), torque, (self.torque_Nm, self.stiffness_Nm_rad), state=True),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        return Native((CouplingBristle(need_coupling(chain, self.place), self.torque_Nm, self.stiffness_Nm_rad),))

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for, or None."""
        if not isinstance(value, CouplingBristle):
            return None
        return cls(place=chain.couplings[value.coupling].place, torque_Nm=value.level, stiffness_Nm_rad=value.stiffness)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        return bristles(self.torque_Nm, self.stiffness_Nm_rad, 8.0 * scales.deflection)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        return [
            {"torque_Nm": part * stiffness * scales.deflection, "stiffness_Nm_rad": stiffness}
            for stiffness in (0.3 * scales.stiffness, 2.0 * scales.stiffness) for part in (0.2, 1.0)
        ]  # fmt: skip
