"""JSON of results: no infinities, no NumPy numbers, nothing half-written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ident.serial import write_atomic

__all__ = ["json_text", "write_json"]


def write_json(path: Path, said: Mapping[str, Any]) -> None:
    """Write plain values in one move; a number that is not finite becomes null."""
    write_atomic(path, json_text(said) + "\n")


def json_text(said: Any, indent: int | None = 2) -> str:
    """JSON of plain values; a number that is not finite becomes null, for which JSON has no other word."""
    return json.dumps(_finite(said), indent=indent, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
