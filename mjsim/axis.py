"""The axis: a chain and the effects laid on it. Models compose by ``+``."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from mjsim.chain import Body, Chain, Coupling, LinearParameter
from mjsim.effects.base import Effect
from mjsim.effects.ports import BacklashLaw
from mjsim.site import Site

__all__ = ["Axis", "Body", "Chain", "Coupling", "LinearParameter"]


@dataclass(frozen=True)
class Axis:
    """A chain with effects; ``axis + effect`` is a new axis. The backlash law is a named option of the axis."""

    chain: Chain
    effects: tuple[Effect, ...] = ()
    backlash_law: BacklashLaw = BacklashLaw.GATED

    def __post_init__(self) -> None:
        keys = [e.key for e in self.effects]
        doubled = {k for k in keys if keys.count(k) > 1}
        if doubled:
            raise ValueError(f"effect laid on the axis twice: {', '.join(sorted(doubled))}")

    def __add__(self, effect: Effect) -> Axis:
        """The axis with one more effect."""
        if not isinstance(effect, Effect):
            return NotImplemented
        return dataclasses.replace(self, effects=(*self.effects, effect))

    def with_effects(self, effects: Sequence[Effect]) -> Axis:
        """The axis with more effects; one that refines an effect of it takes its place."""
        return dataclasses.replace(self, effects=(*self.kept_beside(effects), *effects))

    def kept_beside(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Its effects that none of some others refines at its place: one that refines an effect takes its place."""
        return tuple(e for e in self.effects if not any(e.place == f.place and e.id in type(f).refines for f in effects))

    @property
    def start_states(self) -> dict[str, float]:
        """Numbers of its effects that are states at the first sample, by ``id@place.name`` (`Effect.start_parameter`)."""
        own = [(e, type(e).start_parameter) for e in self.effects]
        return {f"{e.key}.{name}": e.values[name] for e, name in own if name}

    def started(self, states: Iterable[tuple[str, float]]) -> Axis:
        """The axis with these numbers of `start_states`; those of effects that it does not have are left out."""
        own = {name: value for name, value in states if name in self.start_states}
        return self.with_values(own) if own else self

    def at(self, site: Site) -> tuple[Effect, ...]:
        """Its effects at a site of the chain."""
        return tuple(e for e in self.effects if e.site(self.chain) == site)

    def without(self, key: str) -> Axis:
        """The axis without the effect of this key (``id@place``)."""
        if key not in {e.key for e in self.effects}:
            raise KeyError(f"no effect {key!r}; there are {', '.join(e.key for e in self.effects) or 'none'}")
        return dataclasses.replace(self, effects=tuple(e for e in self.effects if e.key != key))

    def with_linear(self, values: Mapping[str, float]) -> Axis:
        """The axis with some linear parameters replaced."""
        return dataclasses.replace(self, chain=self.chain.with_linear(values))

    def with_values(self, values: Mapping[str, float]) -> Axis:
        """The axis with some numbers replaced: linear parameters by name, those of its effects as ``id@place.name``."""
        own = {key: value for key, value in values.items() if "@" in key}
        effects = [e.with_values({n: own.pop(f"{e.key}.{n}", v) for n, v in e.values.items()}) for e in self.effects]
        if own:
            raise KeyError(f"no effect of the axis has {next(iter(own))!r}")
        linear = {name: value for name, value in values.items() if "@" not in name}
        return dataclasses.replace(self.with_linear(linear), effects=tuple(effects))
