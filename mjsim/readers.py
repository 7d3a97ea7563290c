"""Tables of numbers from files: CSV, MAT, NPZ, Parquet, MCAP. Each reader gives {column: array} or one clear line."""

from __future__ import annotations

import csv
import importlib
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mjsim.errors import InputError

__all__ = ["READERS", "read_table"]

Table = dict[str, np.ndarray]


def read_table(path: Path) -> Table:
    """Every numeric column of a file by its name; matrices keep their shape (rows, samples)."""
    if path.stat().st_size == 0:
        raise InputError(path, "the file is empty", "a recording", "record it again")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(path, f"unknown kind of file {path.suffix!r}", f"one of {', '.join(READERS)}", "convert it")
    table = reader(path)
    if not table:
        raise InputError(path, "no numeric column", "at least time, torque and one output", "check the file")
    return table


def _csv(path: Path) -> Table:
    try:
        with path.open(newline="", encoding="utf-8-sig") as handle:
            header = [h.strip() for h in next(csv.reader(handle))]
            other = next((c for c in ";\t|" if len(header) == 1 and c in header[0]), None)
            if other is not None:
                raise InputError(
                    path, f"row 1: columns are separated by {other!r}", "commas, and points in the numbers",
                    "export it with commas",
                )  # fmt: skip
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # a table without rows is said below
                    data = np.loadtxt(handle, delimiter=",", ndmin=2)
            except ValueError:
                raise _bad_cell(path, header) from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError(path, "not a text file", "comma-separated values", "name it by its true format") from None
    if "" in header or len(set(header)) != len(header):
        raise InputError(path, "row 1: empty or repeated column name", "one name per column", "correct the header")
    if all(_is_number(h) for h in header):
        raise InputError(path, "row 1 holds numbers", "a header with column names", "add a header")
    if data.size == 0:
        raise InputError(path, "a header and no data", "one row per sample", "record it again")
    if data.shape[1] != len(header):
        raise InputError(path, f"{data.shape[1]} columns under {len(header)} names", "as many", "correct the header")
    return {h: data[:, i].copy() for i, h in enumerate(header)}


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _bad_cell(path: Path, header: list[str]) -> InputError:
    """Name the first row and column that is not a number."""
    with path.open(newline="", encoding="utf-8-sig") as handle:
        for number, row in enumerate(csv.reader(handle), start=1):
            if number == 1 or not row:
                continue
            if len(row) != len(header):
                return InputError(path, f"row {number} has {len(row)} cells", f"{len(header)}", "correct or remove the row")
            for name, cell in zip(header, row, strict=True):
                if not _is_number(cell):
                    return InputError(path, f"row {number}, column {name!r}: {cell!r}", "a number", "correct or remove the row")
    return InputError(path, "not comma-separated numbers", "CSV", "check the file")


def _mat(path: Path) -> Table:
    from scipy.io import loadmat

    try:
        content = loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except (ValueError, NotImplementedError, TypeError, OSError) as error:
        hint = "save it with -v7" if isinstance(error, NotImplementedError) else "name it by its true format"
        raise InputError(path, f"not a readable MAT file ({str(error).splitlines()[0]})", "MATLAB v4 to v7", hint) from None
    table: Table = {}

    def add(name: str, value: Any) -> None:
        if hasattr(value, "_fieldnames"):
            for field in value._fieldnames:
                add(f"{name}.{field}" if name else field, getattr(value, field))
            return
        array = np.asarray(value)
        if array.dtype.kind in "fiub" and array.ndim in (1, 2) and array.size > 1:
            table[name] = array.astype(float)

    for name, value in content.items():
        if not name.startswith("__"):
            add(name, value)
    return table


def _npz(path: Path) -> Table:
    try:
        with np.load(path, allow_pickle=False) as content:
            return {
                k: content[k].astype(float)
                for k in content.files
                if content[k].dtype.kind in "fiub" and content[k].ndim in (1, 2)
            }
    except (ValueError, OSError) as error:
        raise InputError(path, f"not a readable NPZ file ({error})", "numpy.savez", "name it by its true format") from None


def _need(package: str, path: Path) -> Any:
    """Import an optional package, or say in one line how to get it."""
    try:
        return importlib.import_module(package)
    except ImportError:
        top = package.partition(".")[0]
        raise InputError(
            path, f"the Python package {top!r} that reads {path.suffix} is not installed", "it", "pip install 'simgap[formats]'"
        ) from None


def _parquet(path: Path) -> Table:
    arrow = _need("pyarrow", path)
    parquet = _need("pyarrow.parquet", path)
    try:
        read = parquet.ParquetFile(str(path)).read()
    except (arrow.ArrowException, OSError) as error:
        raise InputError(path, f"not a readable Parquet file ({_line(error)})", "Parquet", "name it by its true format") from None
    table: Table = {}
    for name, column in zip(read.column_names, read.columns, strict=True):
        if not (arrow.types.is_integer(column.type) or arrow.types.is_floating(column.type)):
            continue
        if column.null_count:
            empty = int(np.flatnonzero(column.is_null().to_numpy(zero_copy_only=False))[0])
            raise InputError(path, f"row {empty + 1}, column {name!r} is empty", "a number", "correct or remove the row")
        table[name] = column.to_numpy().astype(float)
    return table


def _mcap(path: Path) -> Table:
    """JSON messages: ``topic.field`` for each number; a column of all topics alike for fields that only one topic has.

    ``topic.log_time`` and ``log_time`` [s] count from the first message. Topics of another length than the longest are left out
    of the short names.
    """
    reader = _need("mcap.reader", path)
    exceptions = _need("mcap.exceptions", path)
    columns: dict[str, dict[str, list[float]]] = {}
    first: int | None = None
    try:
        with path.open("rb") as handle:
            for schema, channel, message in reader.make_reader(handle).iter_messages():
                if channel.message_encoding != "json":
                    kind = channel.message_encoding or (schema.encoding if schema else "")
                    raise InputError(
                        path, f"topic {channel.topic!r} is encoded as {kind!r}", "messages in JSON", "convert it to JSON or CSV"
                    )
                first = message.log_time if first is None else first
                values: dict[str, float] = {"log_time": (message.log_time - first) * 1e-9}
                _flatten(json.loads(message.data), "", values)
                topic = columns.setdefault(channel.topic.strip("/"), {})
                for name, value in values.items():
                    topic.setdefault(name, []).append(value)
    except (exceptions.McapError, ValueError, OSError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, f"not a readable MCAP file ({_line(error)})", "MCAP", "name it by its true format") from None
    return _merge(columns, path)


def _flatten(value: Any, name: str, out: dict[str, float]) -> None:
    """Numbers of a JSON value by their dotted names."""
    if isinstance(value, dict):
        for key, item in value.items():
            _flatten(item, f"{name}.{key}" if name else str(key), out)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            _flatten(item, f"{name}.{i}" if name else str(i), out)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        out[name or "value"] = float(value)


def _merge(columns: dict[str, dict[str, list[float]]], path: Path) -> Table:
    """Long names for all fields; short names for those that one topic alone has."""
    table: Table = {}
    short: dict[str, list[np.ndarray]] = {}
    longest = max((len(c["log_time"]) for c in columns.values()), default=0)
    for topic, fields in columns.items():
        count = len(fields["log_time"])
        for name, values in fields.items():
            if len(values) != count:
                raise InputError(
                    path,
                    f"topic {topic!r}: {name!r} in {len(values)} of {count} messages",
                    "the same fields in all",
                    "split the topic",
                )
            array = np.array(values)
            table[f"{topic}.{name}"] = array
            if count == longest:
                short.setdefault(name, []).append(array)
    table.update({name: arrays[0] for name, arrays in short.items() if len(arrays) == 1 or name == "log_time"})
    return table


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


READERS: dict[str, Callable[[Path], Table]] = {
    ".csv": _csv,
    ".mat": _mat,
    ".npz": _npz,
    ".parquet": _parquet,
    ".mcap": _mcap,
}
