"""How often physics is named where none is missing: measured by the benchmark, shipped, printed with every answer."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files

__all__ = ["false_alarm_rate"]


def false_alarm_rate() -> Mapping[str, float]:
    """share, alarms, recordings of the last calibration; low, high: its interval (Clopper, Pearson, Biometrika 26 (1934) 404).

    Written by ``simgap benchmark --calibration diagnose/verdict/calibration.json``: recordings of a sound
    model by another plant and solver, with white, coloured and repetitive noise, quantised, in open
    and closed loop. Empty where the file is not there.
    """
    try:
        kept = json.loads(files("diagnose.verdict").joinpath("calibration.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    return {name: float(kept[name]) for name in ("share", "low", "high", "alarms", "recordings")}
