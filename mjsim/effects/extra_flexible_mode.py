"""A hidden flexible mode: part of the arm's inertia hangs on a spring of its own.

J_a -> J_a - J_x, joined to J_x by k_x and d_x
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mjsim.effects.admissible import Range, mode, ringing
from mjsim.effects.base import Effect, Scales, need_body, parameter
from mjsim.effects.native import Native, SplitBody
from mjsim.effects.ports import Port, SplitInertia
from mjsim.effects.registry import register
from mjsim.quantity import Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["ExtraFlexibleMode"]


PARTS = (0.25, 0.04)  # of the arm's inertia
STARTS = 36


@register
@dataclass(frozen=True, kw_only=True)
class ExtraFlexibleMode(Effect):
    """A hidden flexible mode; law, convention and source as in the module's text."""

    id: ClassVar[str] = "extra_flexible_mode"
    places: ClassVar[tuple[str, ...]] = ("arm",)
    sentence: ClassVar[str] = (
        "One more flexible mode in the {place}: {inertia_kgm2} of its inertia hangs on a spring of {stiffness_Nm_rad} (tool, link or mounting)."
    )
    citation: ClassVar[str] = "Moberg, Modeling and Control of Flexible Manipulators, Linkoping (2010)"
    tolerance: ClassVar[float] = 1e-5
    amplitudes: ClassVar[tuple[str, ...]] = ("inertia_kgm2", "stiffness_Nm_rad", "damping_Nms_rad")
    sizes: ClassVar[tuple[str, ...] | None] = ("inertia_kgm2", "stiffness_Nm_rad")
    family: ClassVar[str] = "structure"
    multistart: ClassVar[int] = 8

    inertia_kgm2: float = parameter(Quantity.INERTIA, "inertia behind the spring, split off the arm", lower=1e-12)
    stiffness_Nm_rad: float = parameter(Quantity.STIFFNESS, "stiffness of the spring", lower=1e-12)
    damping_Nms_rad: float = parameter(Quantity.DAMPING, "damping beside the spring", lower=0.0)

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where the law acts."""
        body = need_body(chain, self.place)
        return (SplitInertia(body, self.inertia_kgm2, self.stiffness_Nm_rad, self.damping_Nms_rad),)

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for it."""
        body = need_body(chain, self.place)
        return Native((SplitBody(body, self.inertia_kgm2, self.stiffness_Nm_rad, self.damping_Nms_rad),))

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """What a recording shows of it."""
        shown = mode(self.inertia_kgm2, self.stiffness_Nm_rad, scales)
        return (*shown, *ringing(self.inertia_kgm2, self.stiffness_Nm_rad, self.damping_Nms_rad))

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Starts of a fit."""
        out = []
        # what a recording can show: from three turns in all of it to a tenth of its sampling rate
        low, high = 3.0 / scales.duration, 0.1 / scales.dt
        for part in PARTS:
            j = part * scales.inertia
            for hz in low * (high / low) ** (np.arange(STARTS) / (STARTS - 1)):
                w = 2 * math.pi * hz
                out.append({"inertia_kgm2": j, "stiffness_Nm_rad": j * w * w, "damping_Nms_rad": 0.06 * j * w})
        return out
