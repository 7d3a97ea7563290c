"""Recordings from files; of a file that is too long to be fitted as a whole, its most informative stretches."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.data.stretches import Stretches, choose
from diagnose.result import Estimate
from diagnose.thresholds import LONGEST
from diagnose.verdict.friction_over_time import trends
from mjsim.errors import InputError
from mjsim.readers import digest
from mjsim.readers.stream import row_count, windows
from mjsim.recording import Recording, find_binding, from_table, load

__all__ = ["Loaded", "load_all", "told", "trend_sentences"]

ALIKE = math.sqrt(0.9)
"""Correlation above which less than a tenth of the variance of one is left beside the other."""
TOGETHER = "Time and temperature change together, so that the recording cannot tell which of them the friction follows."


@dataclass(frozen=True)
class Loaded:
    """Recordings to fit and to hold out, and what was chosen of those that are too long."""

    fitted: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    stretches: tuple[Stretches, ...] = ()


def load_all(
    recordings: Sequence[Path], held_out: Sequence[Path], model: Path, joint: str | None = None, prefer: str | None = None,
    longest: int = LONGEST, *, driven: bool = True,
) -> Loaded:  # fmt: skip
    """Load files; those with more than ``longest`` rows are read window by window, and stretches of them are chosen.

    ``driven``: whether the model has an actuator. Where nothing else is held out, a third of the stretches is. Raises InputError
    as `mjsim.recording.load` does.
    """
    fitted: list[Recording] = []
    held: list[Recording] = []
    chosen: list[Stretches] = []
    for paths, is_held in ((recordings, False), (held_out, True)):
        for path in paths:
            count = row_count(path) if path.is_file() else None
            if count is None or count <= longest:
                (held if is_held else fitted).append(load(path, model=model, joint=joint, prefer=prefer, driven=driven))
                continue
            part = _stretches(path, model, joint, prefer, is_held if is_held or held_out else None, driven)
            chosen.append(part)
            fitted += part.fitted()
            held += part.held()
    return Loaded(tuple(fitted), tuple(held), tuple(chosen))


def _stretches(
    path: Path, model: Path, joint: str | None, prefer: str | None, held: bool | None, driven: bool
) -> Stretches:  # fmt: skip
    binding = find_binding(path, model)
    errors: list[InputError] = []

    def recordings(rows: int) -> Iterator[tuple[int, Recording | None]]:
        """The windows of the file as recordings; None for one with a gap or a value that is no number."""
        for first, table in windows(path, rows):
            try:
                yield first, from_table(path, table, binding, joint=joint, prefer=prefer, driven=driven)
            except InputError as error:
                errors.append(error)
                yield first, None

    try:
        return choose(path.name, digest(path), recordings, held_out=held)
    except InputError as error:
        raise (errors or [error])[0] from None


def told(stretches: Sequence[Stretches], friction: Mapping[str, Mapping[str, Estimate]]) -> tuple[dict[str, Any], ...]:
    """The stretches for ``diagnosis.json``, each with the friction that was fitted to it alone (by the hash of its samples).

    As well with its mean temperature, where the log has one.
    """
    return tuple(
        {
            **s.as_dict(), **({} if r.temperature is None else {"temperature_degC": float(r.temperature.mean())}),
            "friction": {name: e.as_dict() for name, e in friction.get(r.sha256, {}).items()},
        }
        for part in stretches for s, r in zip(part.chosen, part.recordings, strict=True)
    )  # fmt: skip


def trend_sentences(stretches: Sequence[Stretches], friction: Mapping[str, Mapping[str, Estimate]]) -> list[str]:
    """Which numbers of friction change over the time of each long recording, and which with the temperature.

    A note says so where time and temperature are too strongly correlated (above `ALIKE`) to be separated.
    """
    out = []
    for part in stretches:
        times = [s.start_s for s in part.chosen]
        numbers = [friction.get(r.sha256, {}) for r in part.recordings]
        out += [f"{part.chosen[0].file}: {line.sentence()}" for line in trends(times, numbers) if line.significant]
        if any(r.temperature is None for r in part.recordings):
            continue
        degrees = [float(r.temperature.mean()) for r in part.recordings if r.temperature is not None]
        lines = [line for line in trends(degrees, numbers) if line.significant]
        out += [f"{part.chosen[0].file}: {line.by_temperature()}" for line in lines]
        if lines and abs(np.corrcoef(times, degrees)[0, 1]) > ALIKE:
            out.append(f"{part.chosen[0].file}: {TOGETHER}")
    return out
