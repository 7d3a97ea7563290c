"""What an effect is: a frozen set of parameters with units, a law, an MJCF form, a sentence and a source.

An effect says *where* it enters the equations of the axis by the ports it returns (`mjsim.effects.ports`); runners know
ports and never the effects behind them, so that a new effect is one new file.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

from mjsim.chain import Chain
from mjsim.effects.admissible import Range
from mjsim.effects.native import Native, Value
from mjsim.effects.ports import CouplingTorque, Gap, Port, Twist
from mjsim.effects.scales import Scales
from mjsim.errors import nearest
from mjsim.quantity import Motion, Quantity
from mjsim.servo import Target
from mjsim.site import Site

__all__ = [
    "Effect",
    "NotApplicableError",
    "ParameterSpec",
    "PlaceError",
    "Scales",
    "bristle_stiffnesses",
    "need_body",
    "need_coupling",
    "need_drive",
    "need_servo",
    "need_torque_input",
    "parameter",
]


class NotApplicableError(ValueError):
    """The chain has nothing at the place where the effect would act."""


class PlaceError(ValueError):
    """The effect is not known at this place."""

    def __init__(self, effect: str, place: str, places: Sequence[str]) -> None:
        super().__init__(f"{effect}: place {place!r}; choose from {', '.join(places)}; {nearest(place, places, 'name one')}")
        self.effect = effect
        self.place = place
        self.places = tuple(places)


def need_body(chain: Chain, place: str) -> int:
    """Index of the body at a place; the arm of a rigid axis is its one body. Raises NotApplicableError."""
    i = chain.body(place)
    if i is None:
        raise NotApplicableError(f"this chain of {len(chain.bodies)} bodies has no body at {place!r}")
    return i


def need_drive(chain: Chain) -> None:
    """Refuse a chain without an actuator, or with one that was off. Raises NotApplicableError."""
    if not chain.driven:
        raise NotApplicableError("no actuator drives the axis")


def need_servo(chain: Chain, *, position: bool = False) -> None:
    """Refuse a chain whose input is a torque, or that follows a velocity where ``position``. Raises NotApplicableError."""
    if chain.servo is None:
        raise NotApplicableError("the actuator is driven by a torque, and no servo")
    if position and chain.servo.target is Target.VELOCITY:
        raise NotApplicableError("the servo follows a velocity, and no position")


def need_torque_input(chain: Chain) -> None:
    """Refuse a chain whose input is the command of a servo. Raises NotApplicableError."""
    need_drive(chain)
    if chain.servo is not None:
        raise NotApplicableError("the actuator is a servo: its input is no torque")


def need_coupling(chain: Chain, place: str) -> int:
    """Index of the coupling at a place. Raises NotApplicableError."""
    j = chain.coupling(place)
    if j is None:
        raise NotApplicableError(f"this chain of {len(chain.bodies)} bodies has no elastic coupling at {place!r}")
    return j


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter of an effect: its name, quantity (hence unit), bounds and meaning."""

    name: str
    quantity: Quantity
    lower: float
    upper: float
    about: str
    nuisance: bool

    def unit(self, motion: Motion = Motion.HINGE) -> str:
        """SI unit on this kind of axis."""
        return self.quantity.unit(motion)


def parameter(
    quantity: Quantity,
    about: str,
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
    default: Any = dataclasses.MISSING,
    nuisance: bool = False,
) -> Any:
    """A dataclass field that is a physical parameter; ``nuisance`` ones are estimated anew for each recording."""
    meta = {"parameter": (quantity, lower, upper, about, nuisance)}
    if default is dataclasses.MISSING:
        return field(metadata=meta)
    return field(default=default, metadata=meta)


def bristle_stiffnesses(level: float, scales: Scales, count: int = 4) -> list[float]:
    """Stiffnesses [N m/rad | N/m] to start a bristle of a sliding ``level`` from.

    From one that yields within a fiftieth of the travel to one that rings, on the body's own inertia, by 0.4 rad a sample.
    """
    softest = level / (0.02 * scales.travel)
    stiffest = max(scales.inertia * (0.4 / scales.dt) ** 2, 10.0 * softest)
    return [softest * (stiffest / softest) ** (k / (count - 1)) for k in range(count)]


@dataclass(frozen=True, kw_only=True)
class Effect(abc.ABC):
    """Abstract physical effect; a final subclass is one file of `mjsim.effects`.

    Class attributes: ``id`` (contract identifier), ``places`` it can act at, ``sentence`` (plain words, a format string over
    the parameters and ``place``), ``citation``, ``tolerance`` (relative RMS within which the ODE and the MuJoCo realisation agree
    on motor velocity), ``family`` (effects of one family are rivals before they are partners), ``refines``
    (identifiers of the simpler effects that this one contains), ``multistart`` (from how many of its best starts a fit is
    begun; more than one where the error has several minima), ``rough`` (whether bodies stick or strike by it, so that the error
    jumps as a parameter moves), ``rounds`` (whether it rounds what is measured, so that a small step of a parameter turns single
    samples), ``amplitudes`` (parameters that scale its response together, while small), ``sizes`` (parameters without which it
    is another effect or none, the amplitudes unless given), ``angle_of`` (place
    whose angle a periodic law follows, its own when empty), ``form_of`` (the contract identifier that it is named by, where it is
    another law for the same effect), ``called`` (the contract identifier that it is named by, where the effect of that identifier
    acts on other chains or is a part of it), ``rigid`` (whether it is looked for only on an axis that the model takes for one rigid body), ``once`` (whether its places cannot be told apart, so that a model has it at one of them
    only), ``shown_by_angle`` (whether a measured velocity contradicts the measured angle by it), ``taken_for`` (identifiers of
    such effects that make the same change of a velocity: where the angle shows one, this effect explains nothing without it), ``by_load``
    (whether it grows with the transmitted torque), ``linear`` (whether its torque is linear in each of its numbers, so that a fit moves none
    of them by its logarithm), ``start_parameter`` (the nuisance parameter that is a state of it at the first sample, which every run
    has of its own), ``closes_loop`` (whether it is a further feedback, beside which all numbers of the servo are others: a fit of it
    starts with sensitivities computed anew in every iteration).
    """

    id: ClassVar[str]
    places: ClassVar[tuple[str, ...]]
    sentence: ClassVar[str]
    citation: ClassVar[str]
    tolerance: ClassVar[float] = 1e-4
    family: ClassVar[str] = ""
    multistart: ClassVar[int] = 1
    rough: ClassVar[bool] = False
    rounds: ClassVar[bool] = False
    refines: ClassVar[tuple[str, ...]] = ()
    amplitudes: ClassVar[tuple[str, ...]] = ()
    sizes: ClassVar[tuple[str, ...] | None] = None
    angle_of: ClassVar[str] = ""
    form_of: ClassVar[str] = ""
    called: ClassVar[str] = ""
    rigid: ClassVar[bool] = False
    once: ClassVar[bool] = False
    shown_by_angle: ClassVar[bool] = False
    taken_for: ClassVar[tuple[str, ...]] = ()
    by_load: ClassVar[bool] = False
    linear: ClassVar[bool] = False
    start_parameter: ClassVar[str] = ""
    closes_loop: ClassVar[bool] = False

    place: str = ""

    def __post_init__(self) -> None:
        if not self.place:
            object.__setattr__(self, "place", self.places[0])
        if self.place not in self.places:
            raise PlaceError(self.id, self.place, self.places)
        for spec in self.specs():
            value = float(getattr(self, spec.name))
            if not spec.lower <= value <= spec.upper:
                raise ValueError(
                    f"{self.id}: {spec.name} = {value!r}; expected {spec.lower} <= {spec.name} <= {spec.upper} [{spec.unit()}]"
                )
            object.__setattr__(self, spec.name, value)

    @classmethod
    @functools.cache
    def specs(cls) -> tuple[ParameterSpec, ...]:
        """The parameters, in the order of their fields."""
        return tuple(
            ParameterSpec(f.name, *f.metadata["parameter"]) for f in dataclasses.fields(cls) if "parameter" in f.metadata
        )

    @classmethod
    def name(cls) -> str:
        """The contract identifier that the effect is named by."""
        return cls.form_of or cls.called or cls.id

    @property
    def key(self) -> str:
        """``id@place``: what tells two effects of one model apart."""
        return f"{self.id}@{self.place}"

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name [SI]."""
        return {s.name: getattr(self, s.name) for s in self.specs()}

    def with_values(self, values: Mapping[str, float]) -> Self:
        """A copy with some parameters replaced."""
        return dataclasses.replace(self, **values)  # type: ignore[arg-type]

    def describe(self, motion: Motion = Motion.HINGE) -> str:
        """The plain sentence with the numbers and their units in it."""
        numbers = {}
        for spec in self.specs():
            unit = spec.unit(motion)
            numbers[spec.name] = f"{getattr(self, spec.name):.4g}" + ("" if unit == "1" else f" {unit}")
        return self.sentence.format(place=self.place, **numbers)

    @abc.abstractmethod
    def ports(self, chain: Chain) -> tuple[Port, ...]:
        """Where and by which law the effect enters the equations of this chain."""

    @classmethod
    @abc.abstractmethod
    def starts(cls, scales: Scales) -> Sequence[Mapping[str, float]]:
        """Values to start a fit from, physical multiples of the scales; several where the law has local minima."""

    def second_direction(self) -> Self | None:
        """The effect at other numbers: what both do spans, while small, all that the effect can do. None where one spans it.

        A phase is a quarter of its period on.
        """
        phase = self.values.get("phase_rad")
        return None if phase is None else self.with_values({"phase_rad": phase + 0.5 * math.pi})

    def combined(self, first: float, second: float) -> tuple[Self, float]:
        """The effect that does so much of this one and of its `second_direction`, but for its amplitude, and the factor of that."""
        phase = self.values["phase_rad"] + math.atan2(second, first)
        return self.with_values({"phase_rad": phase}), math.hypot(first, second)

    def admissible(self, scales: Scales) -> tuple[Range, ...]:
        """Ranges in which numbers of it have to lie on a recording of such scales for it to be named; () for none."""
        return ()

    def parts(self) -> tuple[Effect, ...]:
        """Simpler effects that together make the same motion, the one that others refine first; () for none."""
        return ()

    @classmethod
    def whole(cls, parts: Sequence[Effect]) -> Effect | None:
        """The one effect whose `parts()` these are, in any order; None where they are not."""
        return None

    def limits(self) -> tuple[Effect, ...]:
        """Other effects of fewer numbers, not among those that it refines, which it comes to at an edge of its own; () for none."""
        return ()

    def native(self, chain: Chain) -> Native:
        """Values of MJCF's own elements that stand for the effect on this chain, and what they lack of it.

        What is lacking travels in the model's ``<custom>`` element, which simgap reads back.
        """
        return Native((), f"{self.subject}: MJCF has no element for it")

    def nearest(self, chain: Chain, speed: float) -> tuple[Chain, tuple[Effect, ...]] | None:
        """The chain and the effects, all of them with native values, that come nearest to it about a speed [rad/s | m/s] of its body.

        For an effect without native values; None where nothing comes near.
        """
        return None

    @classmethod
    def read(cls, value: Value, chain: Chain) -> Self | None:
        """The effect that a native value of a file stands for; None when it is none of this effect."""
        return None

    def on_coupling(self, chain: Chain) -> bool:
        """Whether it acts in a coupling of this chain, and not on a body or a signal."""
        return any(isinstance(port, CouplingTorque | Gap | Twist) for port in self.ports(chain))

    def site(self, chain: Chain) -> Site:
        """Where it acts on this chain. Raises NotApplicableError when the chain has no such place."""
        found = chain.site(self.place, coupling=self.on_coupling(chain))
        if found is None:
            raise NotApplicableError(f"this chain of {len(chain.bodies)} bodies has no {self.place!r}")
        return found

    def with_load(self, factor: float) -> Self:
        """The effect when the load on the last body, its inertia and its mass, is ``factor`` times what it was."""
        return self

    @property
    def subject(self) -> str:
        """Name and place in words."""
        return f"{self.id.replace('_', ' ')} at the {self.place}"
