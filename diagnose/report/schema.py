"""The JSON Schemas of the files that commands write."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

__all__ = ["SCHEMAS", "diagnosis_schema", "schema_of"]

SCHEMAS = ("diagnosis", "check", "identification")
"""Names of the JSON files that have a schema, without their ending."""


def schema_of(name: str) -> dict[str, Any]:
    """The schema (draft 2020-12) of one of `SCHEMAS`. Raises FileNotFoundError for another name."""
    text = (files("diagnose.report") / f"{name}.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def diagnosis_schema() -> dict[str, Any]:
    """The schema of what a diagnosis of an axis or of a robot writes."""
    return schema_of("diagnosis")
