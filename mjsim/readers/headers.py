"""Columns that are bound by what their headers say: a name for the channel and a unit, as ``Torque [N m]`` or ``angle_deg``."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

__all__ = ["guess", "guess_control"]

ROLES = {
    "time": ("time", "t", "zeit", "stamp", "timestamp"),
    "torque": ("torque", "tau", "moment", "force", "input"),
    "command": ("command", "target", "setpoint", "reference", "goal", "desired"),
    "velocity": ("velocity", "speed", "omega", "vel", "qd", "dq", "drehzahl"),
    "angle": ("angle", "position", "pos", "q", "theta", "winkel"),
}
"""Channel -> words that a header may call it by."""
TESTING = {"torque": ("load",), "angle": ("stroke", "displacement")}
"""The same of testing machines, for channels that no header calls by a word of `ROLES`."""
CONTROL = ("control", "ctrl", "u", "pwm", "duty")
"""Words for the control input of an actuator, which needs no unit."""
ELECTRIC = (*CONTROL, "current", "voltage", "volt", "iq", "armature", "motor", "command", "input")
"""Words for it where the header states a unit of voltage or current."""
SUPPLY = ("supply", "bus", "battery", "vbus", "brake", "limit", "second")
"""Words for a voltage or a current that drives nothing."""
_LENGTHS = ("rad", "deg", "mrad", "rev", "m", "mm", "um", "cm", "in", "ft")
MEASURES = {
    "time": ("s", "ms", "us", "ns"),
    "torque": (
        "Nm", "mNm", "kNm", "Ncm", "lbf in", "lbf ft", "ozf in", "kgf cm", "N", "kN", "lbf", "kip", "kgf",
    ),
    "command": _LENGTHS,
    "velocity": ("rad/s", "deg/s", "rpm", "rev/s", "m/s", "mm/s", "in/s", "ft/s"),
    "angle": _LENGTHS,
}  # fmt: skip
"""Channel -> units that a header may state for it."""
ALIKE = {
    "n m": "Nm", "nm": "Nm", "n*m": "Nm", "°": "deg", "°/s": "deg/s", "1/min": "rpm", "u/min": "rpm", "µs": "us", "sec": "s",
    "inch": "in", "inches": "in", "inch/s": "in/s", "feet": "ft", "kips": "kip", "lbs": "lbf", "lb": "lbf",
    "lbf*in": "lbf in", "lbf-in": "lbf in", "in-lbf": "lbf in", "in lbf": "lbf in", "lb-in": "lbf in", "in-lb": "lbf in",
    "lbf*ft": "lbf ft", "lbf-ft": "lbf ft", "ft-lbf": "lbf ft", "ft lbf": "lbf ft", "lb-ft": "lbf ft", "ft-lb": "lbf ft",
    "ozf-in": "ozf in", "oz-in": "ozf in", "kgf-cm": "kgf cm",
}  # fmt: skip
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]+)[\])]$")
_ENDING = re.compile(r"^(?P<name>.*?)[_/ ](?P<unit>rad_s|deg_s|rev_s|m_s|mm_s|in_s|ft_s|[A-Za-z]+)$")


def guess(columns: Collection[str]) -> dict[str, tuple[str, str]]:
    """Channel -> (column, unit) where exactly one header names the channel and a unit of it."""
    found = _named(columns, ROLES)
    for more in (_named(columns, TESTING), _by_unit(columns)):
        found |= {role: named for role, named in more.items() if role not in found}
    return {role: named[0] for role, named in found.items() if len(named) == 1}


def guess_control(columns: Collection[str]) -> tuple[str, str] | None:
    """The column, with its unit, that holds the control input of an actuator; None unless exactly one header says so.

    A unit of voltage or current, or "1" for a header such as ``ctrl`` or ``pwm``.
    """
    found = []
    for column in columns:
        match = _BRACKETS.match(column.strip()) or _ENDING.match(column.strip())
        unit = None if match is None else _unit(match["unit"])
        electric = unit in ("V", "mV", "A", "mA")
        words = _words(match["name"] if match is not None and electric else column)
        if any(w in SUPPLY for w in words):
            continue
        if electric and any(w in ELECTRIC for w in words):
            found.append((column, str(unit)))
        elif not electric and words and words[-1] in (*CONTROL, "current", "voltage"):
            found.append((column, "1"))
    return found[0] if len(found) == 1 else None


def _words(name: str) -> list[str]:
    return [w for w in re.split(r"[^a-zµ]+", name.lower()) if w]


def _named(columns: Collection[str], words: Mapping[str, Collection[str]]) -> dict[str, list[tuple[str, str]]]:
    """Channel -> the columns, with their units, whose headers name it by one of its words."""
    found: dict[str, list[tuple[str, str]]] = {}
    for column in columns:
        for pattern in (_BRACKETS, _ENDING):
            match = pattern.match(column.strip())
            if match is None:
                continue
            role, unit = _role(match["name"], words), _unit(match["unit"])
            if role is not None and unit in MEASURES[role]:
                found.setdefault(role, []).append((column, unit))
            break
    return found


def _by_unit(columns: Collection[str]) -> dict[str, list[tuple[str, str]]]:
    """Columns whose header is a unit alone that only one channel has: ``rpm``."""
    return {"velocity": [(c, "rpm") for c in columns if c.strip().lower() in ("rpm", "1/min", "u/min")]}


def _role(name: str, known: Mapping[str, Collection[str]]) -> str | None:
    """The channel that the last or the first word of a header names."""
    words = _words(name)
    for word in (words[-1:] + words[:1]) if words else ():
        for role, names in known.items():
            if word in names:
                return role
    return None


def _unit(text: str) -> str:
    unit = " ".join(text.split())
    if unit.endswith("_s"):
        unit = f"{unit[:-2]}/s"
    return ALIKE.get(unit.lower(), unit)
