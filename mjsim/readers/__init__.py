"""Tables of numbers from files: CSV, MAT, NPZ, Parquet, MCAP, ROS bags, LeRobot, SAGE.

Each reader returns a `Table` or raises one clear line.
"""

from mjsim.readers.headers import guess, guess_control
from mjsim.readers.read import READERS, read_table
from mjsim.readers.source import digest, is_source, need_source, part_of
from mjsim.readers.table import MOST_BYTES, Table

__all__ = [
    "MOST_BYTES",
    "READERS",
    "Table",
    "digest",
    "guess",
    "guess_control",
    "is_source",
    "need_source",
    "part_of",
    "read_table",
]
