"""What simgap carries in ``<custom>``: the effects of an axis as JSON, with a version, and how to take the correction back."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import escape

from mjsim.effects import BacklashLaw, Effect, effect_class
from mjsim.errors import InputError
from mjsim.torque_map import TorqueMap

__all__ = ["NAME", "VERSION", "Carried", "Edit", "element", "unpack"]

NAME = "simgap"
VERSION = 1

Edit = tuple[str, str, str, str | None]


@dataclass(frozen=True)
class Carried:
    """What a corrected file says of itself.

    effects and backlash law; ignored: elements that stand for an effect and are no part of the chain; bound: actuator and
    sensors; added (kind, name) and undo (kind, name, attribute, old value), oldest first: what was written into the author's
    file; binding: the TOML text that stood beside it; lacks (effect, line): what plain MuJoCo does without; linear: linear
    parameters by name, where MJCF's elements have other numbers, which make up for what they lack.
    """

    effects: tuple[Effect, ...]
    law: BacklashLaw
    ignored: tuple[str, ...] = ()
    bound: tuple[tuple[str, str], ...] = ()
    added: tuple[tuple[str, str], ...] = ()
    undo: tuple[Edit, ...] = ()
    binding: str = ""
    lacks: tuple[tuple[str, str], ...] = ()
    linear: tuple[tuple[str, float], ...] = ()


def element(carried: Carried) -> list[str]:
    """The <text> element, one line for each effect; numbers keep every digit."""
    effects = [{"id": e.id, "place": e.place, "parameters": e.values} for e in carried.effects if not isinstance(e, TorqueMap)]
    maps = [e.as_dict() for e in carried.effects if isinstance(e, TorqueMap)]
    rows = [
        f'"version": {VERSION}',
        f'"backlash_law": {json.dumps(carried.law.name.lower())}',
        '"effects": [' + ",\n  ".join(map(json.dumps, effects)) + "]",
        *(['"maps": [' + ",\n  ".join(map(json.dumps, maps)) + "]"] if maps else []),
        '"lacks": [' + ",\n  ".join(map(json.dumps, carried.lacks)) + "]",
        *([f'"linear": {json.dumps(dict(carried.linear))}'] if carried.linear else []),
        f'"ignored": {json.dumps(carried.ignored)}',
        f'"bound": {json.dumps(dict(carried.bound))}',
        f'"added": {json.dumps(carried.added)}',
        f'"undo": {json.dumps(carried.undo)}',
        '"binding": [' + ",\n  ".join(map(json.dumps, carried.binding.splitlines())) + "]",
    ]
    text = "{" + ",\n".join(rows) + "}"
    lines = escape(text, {"'": "&apos;"}).split("\n")
    lines[0] = f'<text name="{NAME}" data=\'{lines[0]}'
    lines[-1] += "'/>"
    return lines


def unpack(text: str, source: object) -> Carried:
    """Read it back; raises InputError when it is damaged or of another version."""
    where = f'{source}: <custom> text "{NAME}"'
    try:
        table: Any = json.loads(text)
        version = table["version"]
    except (ValueError, KeyError, TypeError):
        raise InputError(where, "not readable", "what `simgap diagnose` writes", "take a fresh copy of the file") from None
    if version != VERSION:
        raise InputError(where, f"version {version!r}", f"version {VERSION}", "write the file anew with this version of simgap")
    try:
        return Carried(
            (
                *(effect_class(e["id"])(place=e["place"], **e["parameters"]) for e in table["effects"]),
                *(TorqueMap.from_dict(m) for m in table.get("maps", [])),
            ),
            BacklashLaw[str(table["backlash_law"]).upper()],
            tuple(map(str, table.get("ignored", []))),
            tuple((str(k), str(v)) for k, v in table.get("bound", {}).items()),
            tuple((str(k), str(n)) for k, n in table.get("added", [])),
            tuple((str(k), str(n), str(a), None if v is None else str(v)) for k, n, a, v in table.get("undo", [])),
            "".join(f"{line}\n" for line in table.get("binding", [])),
            tuple((str(k), str(line)) for k, line in table.get("lacks", [])),
            tuple((str(k), float(v)) for k, v in table.get("linear", {}).items()),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        said = str(error.args[0]) if error.args else type(error).__name__
        raise InputError(where, said, "effects of the registry with their parameters", "correct or remove the text") from None
