"""The CSV form of SAGE (isaac-sim2real/sage): a folder with ``joint_list.txt``, ``state_motor.csv`` and ``control.csv``.

A cell holds a list, one value a joint; stamps are in microseconds.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from mjsim.errors import InputError
from mjsim.readers.table import Table, need_size

__all__ = ["is_sage", "read_sage"]

STATE, CONTROL, JOINTS = "state_motor.csv", "control.csv", "joint_list.txt"
ROLES = {"positions": "angle_rad", "velocities": "velocity_rad_s", "torques": "torques"}
MICRO = 1e-6


def is_sage(folder: Path) -> bool:
    """Whether a folder has the files of this form."""
    return (folder / STATE).is_file() and (folder / JOINTS).is_file()


def read_sage(folder: Path) -> Table:
    """``time_s``, ``command_time_s`` and of each joint ``command_rad``, ``angle_rad``, ``velocity_rad_s``.

    ``JOINT.torques`` keeps its published name: some robots publish a current there. A control row goes with the state row of the
    same number where both files have as many; else the last command before each state is taken.
    """
    joints = [line.strip() for line in (folder / JOINTS).read_text(encoding="utf-8").splitlines() if line.strip()]
    time, state = _lists(folder / STATE, len(joints))
    columns = {"time_s": time * MICRO}
    notes = ["Joints in the order of joint_list.txt."]
    for key, role in ROLES.items():
        if key in state:
            columns |= {f"{j}.{role}": v for j, v in zip(joints, state[key].T, strict=True)}
    if (folder / CONTROL).is_file():
        at, control = _lists(folder / CONTROL, len(joints))
        command = control.get("positions")
        if command is not None and len(at) == len(time):
            columns["command_time_s"] = at * MICRO
        elif command is not None:
            index = np.searchsorted(at, time, side="right") - 1
            begin = int(np.argmax(index >= 0))
            command, columns = command[index[begin:]], {k: v[begin:] for k, v in columns.items()}
            notes.append("Commands have rows of their own: the last one before each state is taken.")
        if command is not None:
            columns |= {f"{j}.command_rad": v for j, v in zip(joints, command.T, strict=True)}
    return Table.of(columns, notes=tuple(notes))


def _lists(path: Path, joints: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Stamps (N,) and the columns of lists (N, J) of one file."""
    need_size(path, path.name, float(path.stat().st_size))
    with path.open(newline="", encoding="utf-8") as handle:
        reader = csv.reader(handle)
        header = next(reader, [])
        if header[:2] != ["type", "timestamp"]:
            raise InputError(path, f"the header {','.join(header[:4])!r}", "type,timestamp,positions", "export it again")
        rows = [row for row in reader if row]
    for number, row in enumerate(rows, start=2):
        if len(row) != len(header):
            raise InputError(path, f"row {number} has {len(row)} cells", f"{len(header)}", "correct or remove the row")
    time = np.array([_number(path, i + 2, row[1]) for i, row in enumerate(rows)])
    return time, {
        name: np.array([_cell(path, i + 2, row[k], joints) for i, row in enumerate(rows)])
        for k, name in enumerate(header) if k > 1 and name in ROLES
    }  # fmt: skip


def _number(path: Path, row: int, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(path, f"row {row}: {text[:40]!r}", "a number", "correct or remove the row") from None


def _cell(path: Path, row: int, text: str, joints: int) -> list[float]:
    parts = text.strip().removeprefix("[").removesuffix("]").split(",")
    if len(parts) != joints:
        raise InputError(path, f"row {row} holds {len(parts)} values", f"{joints}, one a joint", "correct or remove the row")
    return [_number(path, row, part) for part in parts]
