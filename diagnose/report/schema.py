"""The JSON Schema of ``diagnosis.json``."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

__all__ = ["diagnosis_schema"]


def diagnosis_schema() -> dict[str, Any]:
    """The schema (draft 2020-12) of what a diagnosis of an axis or of a robot writes."""
    text = (files("diagnose.report") / "diagnosis.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema
