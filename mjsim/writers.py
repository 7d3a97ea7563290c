"""Tables of signals to files: CSV, NPZ, Parquet, and MCAP with JSON messages for PlotJuggler and Foxglove."""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from mjsim.errors import InputError, nearest
from mjsim.readers.optional import need

__all__ = ["WRITERS", "write_table"]

Columns = Mapping[str, np.ndarray]
TOPIC = "simgap"
NANO = 1e9


def write_table(path: Path, columns: Columns) -> None:
    """Write columns (N,) by name, in this order, in the format that the ending of the name says (none: CSV), in one move.

    Of MCAP: one message of the topic ``simgap`` a sample, with a field a column, at the time that ``time_s`` gives. Raises
    InputError for an ending that is not known, a package that is not installed, and a place that cannot be written.
    """
    suffix = path.suffix.lower() or ".csv"
    if suffix not in WRITERS:
        raise InputError(path, f"unknown kind of file {path.suffix!r}", f"one of {', '.join(WRITERS)}",
                         nearest(suffix, WRITERS, "name it so"))  # fmt: skip
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=f".part{suffix}")
        os.close(handle)
        try:
            WRITERS[suffix](Path(scratch), columns)
            os.chmod(scratch, 0o644)
            os.replace(scratch, path)
        finally:
            Path(scratch).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(path, f"cannot be written ({error.strerror})", "a writable place", "choose another --out") from None


def _csv(path: Path, columns: Columns) -> None:
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([f"{v:.12g}" for v in row])


def _npz(path: Path, columns: Columns) -> None:
    with path.open("wb") as handle:
        np.savez_compressed(handle, **{name: np.asarray(values) for name, values in columns.items()})  # type: ignore[arg-type]


def _parquet(path: Path, columns: Columns) -> None:
    arrow, parquet = need("pyarrow", path), need("pyarrow.parquet", path)
    parquet.write_table(arrow.table({name: np.asarray(values) for name, values in columns.items()}), str(path))


def _mcap(path: Path, columns: Columns) -> None:
    writer_of = need("mcap.writer", path).Writer
    time = columns.get("time_s", np.arange(len(next(iter(columns.values()))), dtype=float))
    stamps = [round(NANO * float(t - min(time[0], 0.0))) for t in time]
    schema = {"type": "object", "properties": {name: {"type": "number"} for name in columns}}
    with path.open("wb") as handle:
        writer = writer_of(handle)
        writer.start(library="simgap")
        kind = writer.register_schema(name=TOPIC, encoding="jsonschema", data=json.dumps(schema).encode())
        channel = writer.register_channel(topic=TOPIC, message_encoding="json", schema_id=kind)
        for i, (at, row) in enumerate(zip(stamps, zip(*columns.values(), strict=True), strict=True)):
            message = {name: float(value) for name, value in zip(columns, row, strict=True) if np.isfinite(value)}
            writer.add_message(channel, log_time=at, publish_time=at, sequence=i, data=json.dumps(message).encode())
        writer.finish()


WRITERS: dict[str, Callable[[Path, Columns], None]] = {".csv": _csv, ".mcap": _mcap, ".npz": _npz, ".parquet": _parquet}
"""Ending of a name -> what writes such a file."""
