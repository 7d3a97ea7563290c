"""Archives of ``time`` (N,), ``dof_pos`` and ``des_dof_pos`` (N, J), as system identification of legged robots uses them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mjsim.readers.table import Table

__all__ = ["NAMES", "ROLES", "dof_table", "is_dof"]

ROLES = {"dof_pos": "angle_rad", "des_dof_pos": "command_rad", "dof_vel": "velocity_rad_s", "dof_torque": "torque_Nm"}
NAMES = ("joint_names", "dof_names")  # members that may name the joints
HINT = 'the file names no joints: add the member joint_names, or bind each, as [joints.NAME] angle = "dof_pos.0"'


def is_dof(shapes: Mapping[str, tuple[int, ...]]) -> bool:
    """Whether the members of an archive are of this form."""
    time, position = shapes.get("time", ()), shapes.get("dof_pos", ())
    return len(time) == 1 and len(position) in (1, 2) and position[0] == time[0]


def dof_table(shapes: Mapping[str, tuple[int, ...]], read: Callable[[str], np.ndarray], names: Sequence[str] | None) -> Table:
    """Columns ``JOINT.angle_rad`` and so on where the joints are named, ``dof_pos.0`` where they are not; all else as it is.

    One joint without a name has the columns of an axis, ``angle_rad`` and so on.
    """
    out: dict[str, tuple[int, ...]] = {}
    loaders: dict[str, Callable[[], np.ndarray]] = {}

    def add(column: str, shape: tuple[int, ...], loader: Callable[[], np.ndarray]) -> None:
        out[column], loaders[column] = shape, loader

    count = shapes["time"][0]
    for member, shape in shapes.items():
        if member == "time":
            add("time_s", shape, lambda: read("time"))
        elif member not in ROLES or shape[0] != count:
            add(member, shape, lambda member=member: read(member))  # type: ignore[misc]
        elif len(shape) == 1:
            add(ROLES[member], shape, lambda member=member: read(member))  # type: ignore[misc]
        else:
            named = names is not None and len(names) == shape[1]
            if not named and shape[1] == 1:
                add(ROLES[member], (count,), lambda member=member: read(member)[:, 0])  # type: ignore[misc]
                continue
            for j in range(shape[1]):
                column = f"{names[j]}.{ROLES[member]}" if named and names is not None else f"{member}.{j}"
                add(column, (count,), lambda member=member, j=j: read(member)[:, j])  # type: ignore[misc]
    hint = "" if names is not None or "dof_pos.0" not in out else HINT
    return Table(out, loaders, by_joint=names is not None, hint=hint)
