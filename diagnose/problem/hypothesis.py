"""A hypothesis: the nominal chain with a set of effects, all of whose numbers are free, laid out as one scaled vector.

The vector holds, in this order: the linear parameters (as ratios to nominal), the parameters of the effects (those that the
nominal axis has, and those that are supposed) that are shared by all recordings, then for each recording its own: nuisance
parameters (phases) and what is free of the state in which it starts (`diagnose.problem.start_state`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from diagnose.problem import start_state
from diagnose.problem.start_state import Begin
from diagnose.thresholds import MOST_SUBSTEPS, TWICE
from mjsim.axis import Axis
from mjsim.effects import Effect, Scales, effect_class
from mjsim.quantity import Quantity
from mjsim.system import STEP

__all__ = ["Entry", "Hypothesis", "make"]


STIFFEST = 15 / 16 * MOST_SUBSTEPS * STEP  # radians a sample at which a contact may ring; the rest is for the chain's own


@dataclass(frozen=True)
class Entry:
    """One number of the vector: where it belongs, its scale and bounds [SI]; recording is -1 for shared ones.

    ``log``: the vector holds log(value / scale), for inertias and stiffnesses, whose ratio is what a response depends on.
    """

    owner: str
    name: str
    quantity: Quantity
    scale: float
    lower: float
    upper: float
    start: float
    recording: int = -1
    log: bool = False

    def scaled(self, value: float) -> float:
        """SI value -> vector."""
        return math.log(max(value, 1e-300) / self.scale) if self.log else value / self.scale

    def si(self, x: float) -> float:
        """Vector -> SI value; a bound is met exactly, which the last digit of a logarithm would pass."""
        value = self.scale * math.exp(min(x, 600.0)) if self.log else x * self.scale
        if math.isclose(value, self.lower, rel_tol=1e-12):
            return self.lower
        return self.upper if math.isclose(value, self.upper, rel_tol=1e-12) else value

    def slope(self, x: float) -> float:
        """d(SI value) / d(vector)."""
        return self.si(x) if self.log else self.scale

    @property
    def of_start(self) -> bool:
        """Whether it is of the state in which a recording starts."""
        return start_state.is_of_start(self.owner, self.name)

    @property
    def label(self) -> str:
        """owner.name, with the recording's number for its own parameters."""
        tail = "" if self.recording < 0 else f"#{self.recording}"
        return f"{self.owner}.{self.name}{tail}" if self.owner else f"{self.name}{tail}"


@dataclass(frozen=True)
class Hypothesis:
    """A nominal axis, the effects supposed on top of it (with start values), and the layout of the free vector.

    A supposed effect that refines one of the nominal axis takes its place.
    """

    nominal: Axis
    effects: tuple[Effect, ...]
    entries: tuple[Entry, ...]
    n_recordings: int

    @classmethod
    def build(
        cls,
        nominal: Axis,
        effects: tuple[Effect, ...],
        scales: Mapping[str, Scales],
        n_recordings: int,
        begins: tuple[Begin, ...],
        linear: Mapping[str, float] | None = None,
        own: Mapping[tuple[str, str, int], float] | None = None,
        varies: tuple[str, ...] = (),
    ) -> Hypothesis:
        """Lay out a vector; ``linear`` and ``own`` (per-recording values) give starts, the nominal values otherwise.

        ``linear`` holds parameters of the nominal axis's own effects too, as ``id@place.name``.
        ``varies`` names linear parameters that each recording has of its own (an inertia that depends on a pose not recorded).
        """
        entries = []
        for p in nominal.chain.linear_parameters():
            start = (linear or {}).get(p.name, p.value)
            scale = abs(p.value) or abs(start) or _fallback_scale(p.kind, scales)
            gain = p.kind in ("stiffness of the servo", "gain of the servo")
            positive = gain or p.kind in ("inertia", "stiffness", "limit of the servo")
            low, high = (0.1 * scale, 10 * scale) if positive else (-20 * scale, 20 * scale)
            if gain:  # a data sheet gives what the firmware's units come to, or nothing of it
                low, high = 1e-3 * scale, 1e3 * scale
            for r in range(n_recordings) if p.name in varies else (-1,):
                mine = min(max((own or {}).get(("", p.name, r), start), low), high)
                entries.append(Entry("", p.name, p.quantity, scale, low, high, mine, r, positive))
        carried = nominal.kept_beside(effects)
        for effect in (*carried, *effects):
            s = scales[effect.place]
            turning = scales[type(effect).angle_of or effect.place]
            for spec in type(effect).specs():
                if f"{effect.key}.{spec.name}" in nominal.chain.held:
                    continue
                value = getattr(effect, spec.name)
                scale = _scale(spec.quantity, value, turning if spec.quantity is Quantity.CYCLES else s)
                of_ratio = spec.quantity in (Quantity.INERTIA, Quantity.STIFFNESS) and not type(effect).linear
                log = of_ratio and spec.lower >= 0 and value > 0
                wide = (1e-3 * scale, 1e3 * scale) if log else (spec.lower, spec.upper)
                low, high, value = _limits(effect, spec.quantity, wide, value, s, turning)
                entry = (spec.name, spec.quantity, scale, low, high)
                if spec.nuisance:
                    for r in range(n_recordings):
                        start = (own or {}).get((effect.key, spec.name, r), value)
                        entries.append(Entry(effect.key, *entry, start, r, log))
                else:
                    if effect in carried:
                        value = min(max((linear or {}).get(f"{effect.key}.{spec.name}", value), low), high)
                    entries.append(Entry(effect.key, *entry, value, -1, log))
        speed = scales["motor"].velocity
        for r, begin in enumerate(begins):
            for free in start_state.free_numbers(nominal, (*carried, *effects), scales, begin):
                start = (own or {}).get(("", free.name, r), free.value)
                scale = TWICE * free.deviation or 0.1 * speed  # of a prior, so that its residual is that of the nominal numbers
                entries.append(Entry("", free.name, free.quantity, scale, -math.inf, math.inf, start, r))
        entries.sort(key=lambda e: e.recording)
        return cls(nominal, effects, tuple(entries), n_recordings)

    @property
    def start(self) -> np.ndarray:
        """The start as a scaled vector."""
        return np.array([e.scaled(e.start) for e in self.entries])

    @cached_property
    def start_numbers(self) -> int:
        """How many numbers are of states in which recordings start."""
        return sum(e.of_start for e in self.entries)

    @property
    def size(self) -> int:
        """How many numbers describe the structure: all but those of starts."""
        return len(self.entries) - self.start_numbers

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Scaled lower and upper bounds."""
        return np.array([e.scaled(e.lower) for e in self.entries]), np.array([e.scaled(e.upper) for e in self.entries])

    @property
    def reach(self) -> np.ndarray:
        """Largest step of each scaled number in one iteration.

        An order whose wave turns by more than a radian over the travel, or a phase by as much, is another wave, of which the
        sensitivities here say nothing.
        """
        return np.array([1.0 if e.quantity in (Quantity.CYCLES, Quantity.PHASE) else np.inf for e in self.entries])

    @cached_property
    def carried(self) -> tuple[Effect, ...]:
        """The nominal axis's own effects, without those whose place a supposed one takes."""
        return self.nominal.kept_beside(self.effects)

    @cached_property
    def prior_terms(self) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """What is said of numbers beforehand, by the nominal axis or of a start.

        Of how many, whatever is supposed; then, of those that are in the vector, which.

        Their rows among all of them (k,), where they stand in the vector (k,), and their nominal values, scaled (k,).
        """
        nominal = {p.name: p.value for p in self.nominal.chain.linear_parameters()}
        linear = [(i, e.scaled(nominal[e.name])) for i, e in enumerate(self.entries) if e.owner == "" and e.name in nominal]
        rows = [(row, *of) for row, of in enumerate(linear)]
        at = {(e.owner, e.name): i for i, e in enumerate(self.entries) if e.recording < 0}
        count = len(rows)
        for effect in self.nominal.effects:
            for spec in type(effect).specs():
                value = getattr(effect, spec.name)
                if spec.nuisance or value == 0 or not math.isfinite(value) or spec.quantity in (Quantity.CYCLES, Quantity.PHASE):
                    continue
                i = at.get((effect.key, spec.name)) if effect in self.carried else None
                if i is not None:
                    rows.append((count, i, self.entries[i].scaled(value)))
                count += 1
        slots = start_state.slots(self.nominal.chain)
        for i, e in enumerate(self.entries):
            if e.of_start and e.name in slots:
                rows.append((count + e.recording * len(slots) + slots[e.name], i, 0.0))
        count += self.n_recordings * len(slots)
        columns = tuple(zip(*rows, strict=True)) if rows else ((), (), ())
        return count, np.array(columns[0], int), np.array(columns[1], int), np.array(columns[2], float)

    @property
    def rough(self) -> bool:
        """Whether bodies stick or strike by an effect, so that the cost has steps."""
        return any(type(e).rough for e in (*self.carried, *self.effects))

    @cached_property
    def rounding(self) -> list[int]:
        """Where in the vector the numbers of a sensor's rounding are."""
        owners = {e.key for e in (*self.carried, *self.effects) if type(e).rounds}
        return [i for i, e in enumerate(self.entries) if e.owner in owners]

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the supposed effects."""
        return tuple(e.key for e in self.effects)

    def values(self, x: np.ndarray) -> dict[tuple[str, str, int], float]:
        """(owner, name, recording) -> SI value."""
        return {(e.owner, e.name, e.recording): float(e.si(v)) for e, v in zip(self.entries, x, strict=True)}

    @cached_property
    def _numbers_of(self) -> list[tuple[list[int], list[tuple[Effect, list[int]]]]]:
        """Where in the vector the numbers of each recording's axis are: of its chain, and of each of its effects."""

        def of(owner: str, recording: int) -> list[int]:
            own = (-1, recording)
            return [i for i, e in enumerate(self.entries) if e.owner == owner and e.recording in own and not e.of_start]

        effects = (*self.carried, *self.effects)
        return [(of("", r), [(e, of(e.key, r)) for e in effects]) for r in range(self.n_recordings)]

    def axis(self, x: np.ndarray, recording: int = 0) -> Axis:
        """The axis that a vector stands for, with the numbers of one recording."""
        linear, mine = self._numbers_of[recording]
        entries, v = self.entries, x.tolist()
        effects = tuple(
            effect.with_values({entries[i].name: entries[i].si(v[i]) for i in at}) if at else effect for effect, at in mine
        )
        chain = self.nominal.chain.with_linear({entries[i].name: entries[i].si(v[i]) for i in linear})
        return Axis(chain, effects, self.nominal.backlash_law)

    @cached_property
    def _starts(self) -> list[list[int]]:
        """Where in the vector the numbers of each recording's start are."""
        return [[i for i, e in enumerate(self.entries) if e.of_start and e.recording == r] for r in range(self.n_recordings)]

    def initial(self, x: np.ndarray, recording: int) -> np.ndarray | None:
        """Angles and velocities (2, n) relative to the first measured angle, where anything of them is free; else None."""
        values = {self.entries[i].name: float(self.entries[i].si(x[i])) for i in self._starts[recording]}
        return start_state.initial(self.nominal.chain, values)


def _limits(
    effect: Effect, quantity: Quantity, wide: tuple[float, float], value: float, s: Scales, turning: Scales
) -> tuple[float, float, float]:
    """Bounds of a number within ``wide``, and its start: beyond them it says nothing, or what a simpler law says."""
    low, high = wide
    of_friction = type(effect).family == "friction"
    if quantity is Quantity.VELOCITY and of_friction:
        # what fades over less than a thousandth of the speed is a level at rest, which static friction has
        low = max(low, 1e-3 * s.velocity)
    elif quantity is Quantity.STIFFNESS and of_friction:
        # a stiffer contact rings faster than the fitting engine may step, and is a level of friction by then
        return low, max(value, min(high, s.inertia * (STIFFEST / s.dt) ** 2)), value
    elif quantity is Quantity.TIME and of_friction:
        # what is over within a fiftieth of the recording is the start of it, and no drift
        low = max(low, 0.02 * s.duration)
    elif quantity is Quantity.CYCLES and effect.place != "arm":
        # of less than half a period nothing tells that it is periodic
        low = max(low, math.pi / max(turning.travel, 1e-12))
    else:
        return low, high, value
    return low, high, max(value, low)


def _scale(quantity: Quantity, value: float, s: Scales) -> float:
    if quantity is Quantity.PHASE:
        return 1.0
    if quantity is Quantity.CYCLES:
        return 1.0 / max(s.travel, 1e-12)
    if value != 0 and math.isfinite(value):
        return abs(value)
    return {
        Quantity.TORQUE: 0.05 * s.torque,
        Quantity.RATIO: 0.1,
        Quantity.TIME: s.dt,
        Quantity.VELOCITY: 0.05 * s.velocity,
        Quantity.ANGLE: 0.1 * (s.deflection or s.travel),
    }.get(quantity, 1.0)


def _fallback_scale(kind: str, scales: Mapping[str, Scales]) -> float:
    """Scale of a linear parameter whose nominal value is zero."""
    s = scales["motor"]
    if kind == "zero of the servo":
        return max(0.02 * s.travel, 1e-12)
    return max(s.torque / max(s.velocity, 1e-12), 1e-12) * (0.05 if kind == "viscous" else 1.0)


def make(effect_id: str, place: str, values: Mapping[str, float]) -> Effect:
    """An effect by identifier with start values clipped into its bounds."""
    cls = effect_class(effect_id)
    clipped = {s.name: min(max(values[s.name], s.lower), s.upper) for s in cls.specs()}
    return cls(place=place, **clipped)
