"""Which cases are in the panel, in which order they run, and which are its quick subset."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from importlib.resources import files
from typing import Any

from lab.panel.case import Case
from lab.panel.examples import example_cases
from lab.panel.machines import machine_cases
from lab.panel.practice import practice_cases
from lab.panel.sealed import cited_cases, sealed_cases
from lab.panel.wishes import wish_cases
from mjsim.errors import InputError

__all__ = ["all_cases", "choose", "quick_cases", "select", "strata"]


@cache
def all_cases() -> tuple[Case, ...]:
    """Every case: practice, machines, examples and wishes first, then the sealed and cited ones in the order of a hash."""
    first = [*practice_cases(), *machine_cases(), *example_cases(), *wish_cases()]
    cases = (*first, *sorted([*sealed_cases(), *cited_cases()], key=_order))
    assert len({c.id for c in cases}) == len(cases)
    return cases


def _order(case: Case) -> str:
    """An order that follows from the name alone: any first part of it is a sample."""
    return sha256(case.id.encode()).hexdigest()


def select(ids: Sequence[str]) -> list[Case]:
    """Cases by name. Raises InputError for one that is not in the panel."""
    known = {c.id: c for c in all_cases()}
    for name in ids:
        if name not in known:
            raise InputError(f"case {name!r}", "not in the panel", "a name that `python -m lab.panel list` prints")
    return [known[name] for name in ids]


def _data() -> dict[str, Any]:
    table: dict[str, Any] = json.loads((files("lab.panel") / "data" / "quick.json").read_text(encoding="utf-8"))
    return table


def quick_cases() -> list[Case]:
    """The quick subset, as its data file has it."""
    return select(_data()["cases"])


def strata() -> dict[str, int]:
    """How many cases the quick subset takes of each stratum."""
    counts: dict[str, int] = _data()["strata"]
    return counts


def choose(counts: dict[str, int], cpu_seconds: dict[str, float], cap: float) -> list[str]:
    """The first cases of each stratum in the order of their hash, without those that took longer than ``cap`` [s of CPU time].

    A case that was not measured counts as short.
    """
    chosen = []
    for stratum, count in counts.items():
        inside = sorted((c for c in all_cases() if c.stratum == stratum), key=_order)
        chosen += [c.id for c in inside if cpu_seconds.get(c.id, 0.0) <= cap][:count]
    return chosen
