"""Parquet files."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.optional import need
from mjsim.readers.table import Table, need_size

__all__ = ["read_parquet"]


def read_parquet(path: Path) -> Table:
    """Numeric columns; each is read when it is asked for, and must then hold no empty cell."""
    arrow = need("pyarrow", path)
    file = need("pyarrow.parquet", path).ParquetFile(str(path))
    schema = file.schema_arrow
    if len(set(schema.names)) != len(schema.names):
        raise InputError(path, "a column name occurs twice", "one name per column", "rename one")
    numeric = [f.name for f in schema if arrow.types.is_integer(f.type) or arrow.types.is_floating(f.type)]
    count = file.metadata.num_rows
    return Table(dict.fromkeys(numeric, (count,)), {name: partial(_column, path, file, name) for name in numeric})


def _column(path: Path, file: Any, name: str) -> np.ndarray:
    need_size(path, name, 8.0 * file.metadata.num_rows)
    column = file.read(columns=[name]).column(0)
    if column.null_count:
        empty = int(np.flatnonzero(column.is_null().to_numpy(zero_copy_only=False))[0])
        raise InputError(path, f"row {empty + 1}, column {name!r} is empty", "a number", "correct or remove the row")
    return np.asarray(column.to_numpy().astype(float))
