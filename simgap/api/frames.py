"""Tables for pandas, which is loaded where a table is asked for and is no requirement of simgap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas

__all__ = ["frame"]


def frame(columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> pandas.DataFrame:
    """A DataFrame of rows with these columns, in this order. Raises InputError where pandas is not installed."""
    try:
        import pandas
    except ImportError:
        from mjsim.errors import InputError

        raise InputError("to_frame", "the Python package 'pandas' is not installed", "it", "pip install pandas") from None
    return pandas.DataFrame(list(rows), columns=list(columns))
