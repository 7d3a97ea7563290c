"""The registry of effects: a decorator that raises on a duplicate, and a lookup that lists the choices."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from mjsim.effects.base import Effect
from mjsim.errors import nearest

__all__ = ["effect_class", "named_instead", "register", "registered"]

OTHER_NAMES = {"current_limit": ("actuator_saturation", "with torque = kt i, a limit of the current is one of the torque")}
"""Names in use for effects that stand under another identifier, and why it is the same."""

_REGISTRY: dict[str, type[Effect]] = {}
E_ = TypeVar("E_", bound=type[Effect])


def register(cls: E_) -> E_:
    """Class decorator: enter an effect under its ``id``; a duplicate raises."""
    if cls.id in _REGISTRY:
        raise ValueError(f"effect {cls.id!r} is registered twice: {_REGISTRY[cls.id].__module__} and {cls.__module__}")
    _REGISTRY[cls.id] = cls
    return cls


def registered() -> dict[str, type[Effect]]:
    """All effects by id, in the order of registration."""
    return dict(_REGISTRY)


def effect_class(name: str) -> type[Effect]:
    """The effect with this id; an unknown one raises KeyError naming the choices."""
    try:
        return _REGISTRY[name]
    except KeyError:
        raise KeyError(f"unknown effect {name!r}; choose from {', '.join(_REGISTRY)}") from None


def named_instead(name: str, choices: Iterable[str], advice: str = "name one of them") -> str:
    """Advice for an unknown effect: the identifier under which the library holds it, else that of `mjsim.errors.nearest`."""
    known = list(choices)
    other, why = OTHER_NAMES.get(name, ("", ""))
    return f"use {other!r}: {why}" if other in known else nearest(name, known, advice)
