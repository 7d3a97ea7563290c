"""The records of a fleet as one table: a row for each parameter of each finding, and one for each recording without findings."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from mjsim.errors import writing

__all__ = ["COLUMNS", "read_records", "rows", "without_diagnosis", "write_parquet"]

COLUMNS = {
    "robot": str, "date": str, "log": str, "joint": str, "verdict": str, "effect": str, "place": str, "parameter": str,
    "value": float, "low": float, "high": float, "unit": str, "p_value": float, "nominal_held_out": float,
    "corrected_held_out": float, "seconds": float, "summary": str, "next_experiment": str, "problem": str, "key": str,
}  # fmt: skip
"""Columns and their types; empty cells are null."""

NONE = {"refused": "refused", "fault": "failed"}


def read_records(out: Path, keys: Iterable[str]) -> Iterator[dict[str, Any]]:
    """The records of some keys, in their order; a key without a record is left out."""
    from simgap.fleet.task import place

    for key in keys:
        path = place(out, key)
        if path.is_file():
            yield json.loads(path.read_text(encoding="utf-8"))


def rows(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The rows of one record.

    Verdict ``refused``: the recording cannot be used; ``failed``: a fault; the reason is in ``problem``.
    """
    job = record["job"]
    base = dict.fromkeys(COLUMNS) | {
        "robot": job["robot"], "date": job["date"], "log": job["log"], "key": job["key"], "seconds": record.get("seconds"),
    }  # fmt: skip
    found = record.get("diagnosis")
    if found is None:
        kind = next(k for k in NONE if k in record)
        return [base | {"verdict": NONE[kind], "problem": record[kind]}]
    base |= {"summary": found.get("summary"), "next_experiment": found.get("next_experiment")}
    joints = found.get("joints") or {}
    parts = joints.items() if joints else [("", found)]
    return [row for joint, part in parts for row in _of_joint(base, str(joint), part)]


def without_diagnosis(table: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The rows of recordings that were refused, or whose diagnosis failed."""
    return [r for r in table if r["verdict"] in NONE.values()]


def _of_joint(base: Mapping[str, Any], joint: str, part: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of one joint of a robot, or of an axis (joint "")."""
    fit = part.get("fit", {})
    errors = {f"{name}_held_out": fit[name].get("held_out_rms") for name in ("nominal", "corrected") if fit.get(name) is not None}
    own = {**base, "joint": joint, "verdict": part.get("verdict"), **errors}
    out = [
        own | {
            "effect": f["effect"], "place": f.get("place"), "parameter": name, "value": e["value"], "low": e["ci95"][0],
            "high": e["ci95"][1], "unit": e.get("unit"), "p_value": f.get("evidence", {}).get("p_value"),
        }
        for f in part.get("findings", ()) for name, e in f["parameters"].items()
    ]  # fmt: skip
    return out or [own]


def write_parquet(path: Path, table: Iterable[Mapping[str, Any]]) -> int:
    """Write rows as Parquet, beside the final name first; returns how many."""
    import pyarrow
    import pyarrow.parquet

    listed = list(table)
    types = {str: pyarrow.string(), float: pyarrow.float64()}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in COLUMNS.items()])
    columns = {name: [_cell(r[name], kind) for r in listed] for name, kind in COLUMNS.items()}
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with writing(path):
            pyarrow.parquet.write_table(pyarrow.table(columns, schema=schema), part)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return len(listed)


def _cell(value: Any, kind: type) -> Any:
    return None if value is None else kind(value)
