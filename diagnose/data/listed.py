"""The recordings of a diagnosis as `diagnosis.json` lists them, and what it says of how their input goes between samples."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from mjsim.hold import HOLDS
from mjsim.recording import Recording
from mjsim.robot.recording import RobotRecording

__all__ = ["as_taken", "holds_beside", "holds_of", "listed"]

R = TypeVar("R", Recording, RobotRecording)


def listed(recordings: Iterable[R], held_out: Iterable[R]) -> tuple[dict[str, str], ...]:
    """File, SHA-256, role, and hold of the input as it was taken, of each recording."""
    return tuple(
        {"file": r.source, "sha256": r.sha256, "role": role, "hold": r.hold}
        for role, group in (("estimation", recordings), ("held-out", held_out)) for r in group
    )  # fmt: skip


def holds_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Hold of each recording by its SHA-256, of rows as `listed` gives them; those of earlier versions have none."""
    return {str(row["sha256"]): str(row["hold"]) for row in rows if row.get("hold") in HOLDS}


def holds_beside(model: Path) -> dict[str, str]:
    """As `holds_of`, of the diagnosis in whose folder a corrected model lies; empty where there is none."""
    try:
        told = json.loads((model.parent / "diagnosis.json").read_text(encoding="utf-8"))
        return holds_of(told["recordings"])
    except (OSError, ValueError, RecursionError, KeyError, TypeError, AttributeError):
        return {}


def as_taken(r: R, holds: Mapping[str, str]) -> R:
    """A recording with the hold under which it was diagnosed, and a note; as it is where its binding states one."""
    hold = holds.get(r.sha256, r.hold)
    if r.hold_stated or hold == r.hold:
        return r
    said = f"the input between samples is taken as in the diagnosis of this recording: {hold}, since nobody states it"
    return dataclasses.replace(r, hold=hold, notes=(*r.notes, said))
