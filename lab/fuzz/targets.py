"""What is fuzzed: each target reads a file and touches every value of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["TARGETS", "Target"]


@dataclass(frozen=True)
class Target:
    """``read`` takes a file with this ``suffix``; ``instrument``: packages whose branches guide the mutation."""

    suffix: str
    read: Callable[[Path], object]
    instrument: tuple[str, ...] = ("mjsim.readers",)


def _table(path: Path) -> None:
    """Every column, and the windows of the formats that are read in windows."""
    from mjsim.readers import read_table
    from mjsim.readers.stream import row_count, windows

    table = read_table(path)
    for name in table:
        if np.asarray(table[name]).dtype != float:
            raise TypeError(f"{name!r} is not float64")
    if row_count(path) is not None:
        for _, part in windows(path, 5):
            dict(part)


def _binding(path: Path) -> None:
    from mjsim.binding import Binding
    from mjsim.robot.binding import RobotBinding

    RobotBinding.from_toml(path)
    Binding.from_toml(path)


def _model(path: Path) -> None:
    from mjsim.mjcf import load_model

    load_model(path)


def _baseline(path: Path) -> None:
    from simgap.gating.check import read_baseline

    read_baseline(path, "corrected")


def _ledger(path: Path) -> None:
    """A damaged line is dropped and never read with other values; what remains is read again as it was read first."""
    from diagnose.fit.ledger import Ledger

    first = Ledger(path, "this")
    if Ledger(path, "this").size != first.size:
        raise ValueError("the file that was repaired reads otherwise")
    entry = first.recall("a")
    if entry is not None and (list(entry.x), entry.cost, entry.iterations, entry.n, entry.work) != ([1.0, 1.0], 1.0, 3, 9, 4):
        raise ValueError("an altered line was read")


TARGETS: dict[str, Target] = {
    **{kind: Target(f".{kind}", _table) for kind in ("csv", "npz", "mat", "parquet", "mcap")},
    "hdf5": Target(".mat", _table),
    "toml": Target(".toml", _binding, ("mjsim.binding", "mjsim.robot.binding")),
    "mjcf": Target(".xml", _model, ("mjsim.mjcf",)),
    "corrected": Target(".xml", _model, ("mjsim.mjcf",)),
    "baseline": Target(".json", _baseline, ("simgap.gating.check",)),
    "ledger": Target(".jsonl", _ledger, ("diagnose.fit.ledger",)),
}
