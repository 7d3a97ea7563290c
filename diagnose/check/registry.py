"""The registry of checks: a check is a pure function ``(recording, machine, context) -> list[Problem]``, one fault a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from diagnose.check.context import Context
    from diagnose.check.machine import Machine
    from diagnose.check.types import Problem
    from mjsim.recording import Recording

__all__ = ["Check", "CheckFunction", "check", "checks"]

CheckFunction = Callable[["Recording", "Machine", "Context"], "list[Problem]"]


@dataclass(frozen=True)
class Check:
    """A registered check: the identifiers of the problems that it can report, what it asks, and the function."""

    problems: tuple[str, ...]
    question: str
    run: CheckFunction


_CHECKS: dict[str, Check] = {}


def check(name: str, *problems: str, question: str) -> Callable[[CheckFunction], CheckFunction]:
    """Register a check under a name. Raises ValueError when the name or a problem is taken."""

    def register(function: CheckFunction) -> CheckFunction:
        taken = {p for c in _CHECKS.values() for p in c.problems}
        if name in _CHECKS or taken & set(problems):
            raise ValueError(f"check {name!r} or one of its problems is registered already")
        _CHECKS[name] = Check(problems, question, function)
        return function

    return register


def checks() -> Mapping[str, Check]:
    """Every check by name, in the order in which they run; those of `diagnose.check.faults` once that is imported."""
    return MappingProxyType(_CHECKS)
