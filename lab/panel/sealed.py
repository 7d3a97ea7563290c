"""Cases of sealed seeds: whole samples, and single cases on which the search was developed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from lab.benchmark.cases import LEVELS, effects_of, make_case
from lab.benchmark.grade import parse_levels
from lab.benchmark.resume import plain
from lab.benchmark.seal import write_motion
from lab.panel.case import Case, Content
from lab.panel.shipped import copy_model

__all__ = ["cited_cases", "numbered", "sealed_cases"]


def numbered(seed: int, levels: str) -> dict[str, tuple[str, int]]:
    """(level, index) of each case of a sealed seed by its number, as `lab.benchmark.seal.write_cases` shuffles them."""
    drawn = [(level, k) for level, count in parse_levels(levels, "quick").items() for k in range(count)]
    order = np.random.default_rng([seed, 2**31]).permutation(len(drawn))
    return {f"{number + 1:03d}": drawn[job] for number, job in enumerate(order)}


def _make(seed: int, level: str, index: int, folder: Path) -> Content:
    """Draw a case as the seal does: a generator of its own, seeded by (seed, level, index), the effects of a level in turn."""
    which = list(LEVELS).index(level)
    turn = np.random.default_rng([seed, which, 2**31]).permutation(effects_of(level)).tolist()
    case = make_case(level, np.random.default_rng([seed, which, index]), turn[index % len(turn)] if turn else None)
    write_motion(folder / "estimation.csv", case.estimation)
    write_motion(folder / "held_out.csv", case.held_out)
    model = copy_model("robot_axis1", folder)
    return Content(("estimation.csv",), ("held_out.csv",), model, truth=plain({**case.truth, "seed": [seed, which, index]}))


def _cases(origin: str, seed: int, levels: str, numbers: list[str] | None = None) -> Iterator[Case]:
    for number, (level, index) in numbered(seed, levels).items():
        if numbers is None or number in numbers:
            yield Case(f"s{seed}_{number}", origin, level, partial(_make, seed, level, index))


def _data() -> dict[str, list[dict[str, Any]]]:
    table: dict[str, list[dict[str, Any]]] = json.loads((files("lab.panel") / "data" / "seeds.json").read_text(encoding="utf-8"))
    return table


def sealed_cases() -> list[Case]:
    """All cases of the seeds that are in the panel as whole samples."""
    return [c for row in _data()["sealed"] for c in _cases("sealed", row["seed"], row["levels"])]


def cited_cases() -> list[Case]:
    """Single cases of other seeds: those on which the search was developed, or which it answered wrongly."""
    return [c for row in _data()["cited"] for c in _cases("cited", row["seed"], row["levels"], row["cases"])]
