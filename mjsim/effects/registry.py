"""The registry of effects: a decorator that raises on a duplicate, and a lookup that lists the choices."""

from __future__ import annotations

from typing import TypeVar

from mjsim.effects.base import Effect

__all__ = ["effect_class", "register", "registered"]

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
