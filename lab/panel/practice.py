"""The practice set: twelve recordings of an independent plant, with published answers."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

from lab.panel.case import Case, Content
from lab.panel.local import local_copy
from lab.panel.shipped import copy_model

__all__ = ["practice_cases", "practice_truth"]

# Where an effect of the practice set acts, unless its answer says so.
PLACES = {"time_delay": "actuator", "extra_flexible_mode": "arm", "backlash": "gearbox"}


def practice_truth(answer: dict[str, Any]) -> dict[str, Any]:
    """An answer of the practice set as the benchmark's envelope has it: with level, verdict and every place."""
    effects = answer["effects"]
    level = ("parameters_only", "plain", "two_effects")[min(len(effects), 2)]
    where = {e: answer["where"].get(e, PLACES.get(e, "motor")) for e in effects}
    return {**answer, "level": level, "verdict": "missing_physics" if effects else "parameters_only", "where": where}


def _make(name: str, folder: Path) -> Content:
    truth = json.loads(local_copy("practice", "truth.json").read_text(encoding="utf-8"))[name]
    parts = ("estimation.csv", "held_out.csv")
    for part in parts:
        shutil.copyfile(local_copy("practice", f"{name}_{part}"), folder / part)
    return Content(parts[:1], parts[1:], copy_model("robot_axis1", folder), truth=practice_truth(truth))


def practice_cases() -> list[Case]:
    """The twelve cases."""
    return [
        Case(f"practice_{name}", "practice", "robot_axis1", partial(_make, name)) for name in (f"p{k:02d}" for k in range(1, 13))
    ]
