"""Comma-separated values."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.table import Table

__all__ = ["read_csv"]


def read_csv(path: Path) -> Table:
    """Comma-separated numbers under a header; cells may be quoted."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as handle:
            header = [h.strip() for h in next(csv.reader(handle), [])]
            other = next((c for c in ";\t|" if len(header) == 1 and c in header[0]), None)
            if other is not None:
                raise InputError(
                    path, f"row 1: columns are separated by {other!r}", "commas, and points in the numbers",
                    "export it with commas",
                )  # fmt: skip
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # a table without rows is said below
                    data = np.loadtxt(handle, delimiter=",", ndmin=2, comments=None, quotechar='"')
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
    return Table.of({h: data[:, i].copy() for i, h in enumerate(header)})


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
