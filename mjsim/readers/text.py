"""Comma-separated values."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.table import Table

__all__ = ["form_of", "read_csv"]

SEPARATORS = ",;\t|"


def read_csv(path: Path) -> Table:
    """Numbers under a header; cells may be quoted.

    Columns are separated by the one of comma, semicolon, tab and bar that the header has; where it is not the comma, numbers of
    the first row with a comma and no point have decimal commas. Both are noted.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as handle:
            by, comma = form_of(handle.readline(), handle.readline())
            handle.seek(0)
            header = [h.strip() for h in next(csv.reader(handle, delimiter=by), [])]
            rows = (line.replace(",", ".") for line in handle) if comma else handle
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # a table without rows is said below
                    data = np.loadtxt(rows, delimiter=by, ndmin=2, comments=None, quotechar='"')
            except ValueError:
                raise _bad_cell(path, header, by, comma=comma) from None
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
    notes = () if by == "," else (f"Columns are separated by {_called(by)}{', decimals by commas' if comma else ''}.",)
    return Table.of({h: data[:, i].copy() for i, h in enumerate(header)}, notes=notes)


def form_of(header: str, row: str) -> tuple[str, bool]:
    """The separator of columns, and whether decimals have commas, from the first two lines of a file."""
    by = _separator(header)
    return by, by != "," and "," in row and "." not in row


def _separator(header: str) -> str:
    """The comma, or the one of the others that a header without commas has most of."""
    counts = {c: header.count(c) for c in SEPARATORS}
    return "," if counts[","] or not any(counts.values()) else max(counts, key=lambda c: counts[c])


def _called(separator: str) -> str:
    return {";": "semicolons", "\t": "tabs", "|": "bars"}[separator]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _bad_cell(path: Path, header: list[str], by: str, *, comma: bool) -> InputError:
    """Name the first row and column that is not a number."""
    with path.open(newline="", encoding="utf-8-sig") as handle:
        for number, row in enumerate(csv.reader(handle, delimiter=by), start=1):
            if number == 1 or not row:
                continue
            if len(row) != len(header):
                return InputError(path, f"row {number} has {len(row)} cells", f"{len(header)}", "correct or remove the row")
            for name, cell in zip(header, row, strict=True):
                if not _is_number(cell.replace(",", ".") if comma else cell):
                    return InputError(path, f"row {number}, column {name!r}: {cell!r}", "a number", "correct or remove the row")
    return InputError(path, "not comma-separated numbers", "CSV", "check the file")
