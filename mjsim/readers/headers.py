"""Columns that are bound by what their headers say: a name for the channel and a unit, as ``Torque [N m]`` or ``angle_deg``."""

from __future__ import annotations

import re
from collections.abc import Collection

__all__ = ["guess"]

ROLES = {
    "time": ("time", "t", "zeit", "stamp", "timestamp"),
    "torque": ("torque", "tau", "moment", "force", "input"),
    "command": ("command", "target", "setpoint", "reference", "goal", "desired"),
    "velocity": ("velocity", "speed", "omega", "vel", "qd", "dq", "drehzahl"),
    "angle": ("angle", "position", "pos", "q", "theta", "winkel"),
}
"""Channel -> words that a header may call it by."""
MEASURES = {
    "time": ("s", "ms", "us", "ns"),
    "torque": ("Nm", "mNm", "kNm", "N", "kN"),
    "command": ("rad", "deg", "mrad", "rev", "m", "mm", "um"),
    "velocity": ("rad/s", "deg/s", "rpm", "m/s", "mm/s"),
    "angle": ("rad", "deg", "mrad", "rev", "m", "mm", "um"),
}
"""Channel -> units that a header may state for it."""
ALIKE = {"n m": "Nm", "nm": "Nm", "n*m": "Nm", "°": "deg", "°/s": "deg/s", "1/min": "rpm", "u/min": "rpm", "µs": "us", "sec": "s"}
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]+)[\])]$")
_ENDING = re.compile(r"^(?P<name>.*?)[_/ ](?P<unit>rad_s|deg_s|m_s|mm_s|[A-Za-z]+)$")


def guess(columns: Collection[str]) -> dict[str, tuple[str, str]]:
    """Channel -> (column, unit) where exactly one header names the channel and a unit of it."""
    found: dict[str, list[tuple[str, str]]] = {}
    for column in columns:
        for pattern in (_BRACKETS, _ENDING):
            match = pattern.match(column.strip())
            if match is None:
                continue
            role, unit = _role(match["name"]), _unit(match["unit"])
            if role is not None and unit in MEASURES[role]:
                found.setdefault(role, []).append((column, unit))
            break
    return {role: columns[0] for role, columns in found.items() if len(columns) == 1}


def _role(name: str) -> str | None:
    """The channel that the last or the first word of a header names."""
    words = [w for w in re.split(r"[^a-zµ]+", name.lower()) if w]
    for word in (words[-1:] + words[:1]) if words else ():
        for role, known in ROLES.items():
            if word in known:
                return role
    return None


def _unit(text: str) -> str:
    unit = " ".join(text.split())
    if unit.endswith("_s"):
        unit = f"{unit[:-2]}/s"
    return ALIKE.get(unit.lower(), unit)
