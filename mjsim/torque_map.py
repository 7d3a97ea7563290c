"""A torque map: a smooth surface, fitted and not derived, in place of physics outside the library.

tau(x, y) = sum over i, j of c_ij B_i(x) B_j(y)

B: cubic B-splines on even knots over x, or over asinh(x / s), which gives small values of x their due (s > 0). The variables are
local quantities of a body or of a coupling; beyond the range of the fit the map keeps the value that it has at the range's edge.
It acts as a torque on a body, or as one added in a coupling (on the side of the body behind).

It is an `Effect` to those who run an axis and stands on no registry: no search considers it, since it is not a cause.
Source of the splines: C. de Boor, A Practical Guide to Splines (1978), ch. IX.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from mjsim.effects.base import Effect, Scales, need_body, need_coupling
from mjsim.effects.law import ANGLE, INPUT, LOAD, POSITION, RATE, TIME, law
from mjsim.effects.ports import BodyTorque, CouplingTorque, Port
from mjsim.quantity import Motion, Quantity

if TYPE_CHECKING:
    from mjsim.chain import Chain

__all__ = ["VARIABLES", "MapAxis", "TorqueMap", "basis"]

_BODY, _COUPLING = (False,), (True,)
# name -> (local quantity, quantity, whether it is a coupling's: for each that has it)
VARIABLES: dict[str, tuple[int, Quantity, tuple[bool, ...]]] = {
    "velocity": (RATE, Quantity.VELOCITY, _BODY),
    "angle": (ANGLE, Quantity.ANGLE, _BODY + _COUPLING),
    "torque command": (INPUT, Quantity.TORQUE, _BODY),
    "load": (LOAD, Quantity.TORQUE, _BODY),
    "time": (TIME, Quantity.TIME, _BODY + _COUPLING),
    "deflection": (POSITION, Quantity.ANGLE, _COUPLING),
    "deflection rate": (RATE, Quantity.VELOCITY, _COUPLING),
}


@law
def surface(z: Any, p: Any, out: Any) -> None:
    """p: for each of the two variables its index, low, knots per unit, intervals, 1 / s or 0; then the coefficients, row by row.

    A map of one variable has no intervals in the second, whose one coefficient per row then counts fully.
    """
    x = z[int(p[0])]
    if p[4] > 0.0:
        x = math.asinh(x * p[4])
    x = min(max((x - p[1]) * p[2], 0.0), p[3])
    i = min(int(x), int(p[3]) - 1)
    x -= i
    columns = 1
    y = 0.0
    j = 0
    if p[8] > 0.0:
        y = z[int(p[5])]
        if p[9] > 0.0:
            y = math.asinh(y * p[9])
        y = min(max((y - p[6]) * p[7], 0.0), p[8])
        j = min(int(y), int(p[8]) - 1)
        y -= j
        columns = int(p[8]) + 3
    total = 0.0
    for a in range(4):
        if a == 0:
            wa = (1.0 - x) ** 3 / 6.0
        elif a == 1:
            wa = (3.0 * x**3 - 6.0 * x**2 + 4.0) / 6.0
        elif a == 2:
            wa = (-3.0 * x**3 + 3.0 * x**2 + 3.0 * x + 1.0) / 6.0
        else:
            wa = x**3 / 6.0
        row = 10 + (i + a) * columns + j
        if columns == 1:
            total += wa * p[row]
        else:
            b0 = (1.0 - y) ** 3 / 6.0
            b1 = (3.0 * y**3 - 6.0 * y**2 + 4.0) / 6.0
            b2 = (-3.0 * y**3 + 3.0 * y**2 + 3.0 * y + 1.0) / 6.0
            b3 = y**3 / 6.0
            total += wa * (b0 * p[row] + b1 * p[row + 1] + b2 * p[row + 2] + b3 * p[row + 3])
    out[0] = total


@dataclass(frozen=True)
class MapAxis:
    """One variable of a map: its name, range [its unit], number of intervals, and s of asinh(x / s) (0: even in x itself)."""

    variable: str
    low: float
    high: float
    intervals: int
    bend: float = 0.0

    def __post_init__(self) -> None:
        if self.variable not in VARIABLES:
            raise ValueError(f"unknown variable {self.variable!r} of a map; choose from {', '.join(VARIABLES)}")
        if not (self.low < self.high and self.intervals >= 1 and self.bend >= 0):
            raise ValueError(
                f"map over {self.variable}: {self.low} to {self.high} in {self.intervals} intervals, bend {self.bend}; "
                "expected low < high, at least one interval, bend >= 0"
            )

    @classmethod
    def spanning(cls, variable: str, values: np.ndarray, intervals: int) -> Self | None:
        """Over nearly all of the values (N,) of a variable, with more knots where speeds are small; None where they are one."""
        low, high = (float(a) for a in np.quantile(values, (0.0005, 0.9995)))
        if not high - low > 1e-9 * max(abs(low), abs(high), 1e-12):
            return None
        speed = VARIABLES[variable][1] is Quantity.VELOCITY and low < 0 < high
        return cls(variable, low, high, intervals, 0.1 * max(abs(low), abs(high)) if speed else 0.0)

    @property
    def count(self) -> int:
        """Number of splines."""
        return self.intervals + 3

    def warped(self, x: np.ndarray) -> np.ndarray:
        """The variable as the knots see it."""
        return np.arcsinh(x / self.bend) if self.bend > 0 else np.asarray(x, float)

    def points(self, count: int) -> np.ndarray:
        """Values of the variable, even as the knots are, from one end of the range to the other."""
        low, high = self.warped(np.array([self.low, self.high]))
        even = np.linspace(low, high, count)
        return self.bend * np.sinh(even) if self.bend > 0 else even

    def numbers(self) -> tuple[float, ...]:
        """As the law reads it."""
        low, high = self.warped(np.array([self.low, self.high]))
        scale = self.intervals / (high - low)
        return VARIABLES[self.variable][0], float(low), float(scale), self.intervals, 1 / self.bend if self.bend > 0 else 0.0


def basis(axis: MapAxis, x: np.ndarray) -> np.ndarray:
    """All splines at x (N,): (N, count); constant beyond the range."""
    _, low, scale, intervals, _ = axis.numbers()
    u = np.clip((axis.warped(np.asarray(x, float)) - low) * scale, 0.0, intervals)
    i = np.minimum(u.astype(int), int(intervals) - 1)
    f = u - i
    weights = ((1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, -3 * f**3 + 3 * f**2 + 3 * f + 1, f**3)
    out = np.zeros((len(u), axis.count))
    for a, w in enumerate(weights):
        out[np.arange(len(u)), i + a] = w / 6.0
    return out


@dataclass(frozen=True, kw_only=True)
class TorqueMap(Effect):
    """A torque over one or two variables; law, splines and source as in the module's text.

    coupling: added in the coupling at the place, else on the body there; axes: one or two; coefficients: row by row, the first
    axis' index slowest [N m | N].
    """

    id: ClassVar[str] = "torque_map"
    places: ClassVar[tuple[str, ...]] = ("motor", "gearbox", "arm")
    sentence: ClassVar[str] = "A map, not a cause."
    citation: ClassVar[str] = "de Boor, A Practical Guide to Splines (1978) ch. IX"
    tolerance: ClassVar[float] = 1e-4

    axes: tuple[MapAxis, ...]
    coefficients: tuple[float, ...]
    coupling: bool = False

    def __post_init__(self) -> None:
        if self.place not in self.places:
            raise ValueError(f"{self.id}: place {self.place!r}; choose from {', '.join(self.places)}")
        if len(self.axes) not in (1, 2):
            raise ValueError(f"{self.id}: {len(self.axes)} variables; expected one or two")
        wrong = [a.variable for a in self.axes if self.coupling not in VARIABLES[a.variable][2]]
        if wrong:
            raise ValueError(f"{self.id}: a {'coupling' if self.coupling else 'body'} has no {', '.join(wrong)}")
        if len(self.coefficients) != self.count(self.axes) or not np.all(np.isfinite(self.coefficients)):
            raise ValueError(f"{self.id}: {len(self.coefficients)} coefficients; expected {self.count(self.axes)} finite ones")
        object.__setattr__(self, "coefficients", tuple(float(c) for c in self.coefficients))

    @staticmethod
    def count(axes: Sequence[MapAxis]) -> int:
        """Number of coefficients."""
        return math.prod(a.count for a in axes)

    def with_coefficients(self, coefficients: np.ndarray) -> TorqueMap:
        """A copy with other coefficients."""
        return TorqueMap(place=self.place, axes=self.axes, coefficients=tuple(coefficients), coupling=self.coupling)

    def with_values(self, values: Mapping[str, float]) -> Self:
        """Itself: a map has no parameters by name."""
        if values:
            raise KeyError(f"{self.id} has no parameters by name; there is {', '.join(values)}")
        return self

    def row(self, *x: np.ndarray) -> np.ndarray:
        """(N, count): what each coefficient counts at the variables' values, each (N,)."""
        b = basis(self.axes[0], x[0])
        if len(self.axes) == 1:
            return b
        products: np.ndarray = np.einsum("ni,nj->nij", b, basis(self.axes[1], x[1])).reshape(len(b), -1)
        return products

    def torque(self, *x: np.ndarray) -> np.ndarray:
        """The map (N,) [N m | N] at the variables' values, each (N,)."""
        torque: np.ndarray = self.row(*x) @ np.array(self.coefficients)
        return torque

    def describe(self, motion: Motion = Motion.HINGE) -> str:
        """What it is, and over what."""
        over = " and ".join(
            f"{a.variable} ({a.low:.3g} to {a.high:.3g} {VARIABLES[a.variable][1].unit(motion)})" for a in self.axes
        )
        where = f"in the {self.place}" if self.coupling else f"at the {self.place}"
        return f"A torque map {where} over {over}: fitted to the residual, not a cause."

    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """A torque on a body or in a coupling."""
        second = self.axes[1].numbers() if len(self.axes) == 2 else (0.0,) * 5
        p = (*self.axes[0].numbers(), *second, *self.coefficients)
        if self.coupling:
            return (CouplingTorque(need_coupling(chain, self.place), surface, p),)
        spatial = max((math.pi * a.intervals / (a.high - a.low) for a in self.axes if a.variable == "angle"), default=0.0)
        return (BodyTorque(need_body(chain, self.place), surface, p, spatial=spatial),)

    @classmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """None: it is never a candidate."""
        return []

    def as_dict(self) -> dict[str, Any]:
        """Everything, for JSON."""
        axes = [
            {"variable": a.variable, "low": a.low, "high": a.high, "intervals": a.intervals, "bend": a.bend} for a in self.axes
        ]
        return {"place": self.place, "coupling": self.coupling, "axes": axes, "coefficients": list(self.coefficients)}

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> TorqueMap:
        """The reverse of `as_dict`; raises KeyError, TypeError or ValueError where it is damaged."""
        axes = tuple(
            MapAxis(str(a["variable"]), float(a["low"]), float(a["high"]), int(a["intervals"]), float(a["bend"]))
            for a in table["axes"]
        )
        return cls(
            place=str(table["place"]), axes=axes, coefficients=tuple(float(c) for c in table["coefficients"]),
            coupling=bool(table["coupling"]),
        )  # fmt: skip
