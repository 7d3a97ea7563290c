"""Tables of numbers from files: CSV, MAT, NPZ, Parquet, MCAP. Each reader returns a `Table` or raises one clear line."""

from mjsim.readers.read import READERS, read_table
from mjsim.readers.table import MOST_BYTES, Table

__all__ = ["MOST_BYTES", "READERS", "Table", "read_table"]
