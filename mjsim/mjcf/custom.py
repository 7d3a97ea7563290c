"""What simgap carries in ``<custom>``: the effects of an axis as JSON, with a version."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from mjsim.effects import BacklashLaw, Effect, effect_class
from mjsim.errors import InputError

__all__ = ["NAME", "VERSION", "Carried", "pack", "unpack"]

NAME = "simgap"
VERSION = 1


@dataclass(frozen=True)
class Carried:
    """Effects, the backlash law, and the elements that were written for them and are not to be read as structure."""

    effects: tuple[Effect, ...]
    law: BacklashLaw
    added: tuple[str, ...]


def pack(carried: Carried) -> str:
    """JSON text; numbers keep every digit."""
    return json.dumps(
        {
            "version": VERSION,
            "backlash_law": carried.law.name.lower(),
            "effects": [{"id": e.id, "place": e.place, "parameters": e.values} for e in carried.effects],
            "added": list(carried.added),
        }
    )


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
        effects = tuple(effect_class(e["id"])(place=e["place"], **e["parameters"]) for e in table["effects"])
        law = BacklashLaw[str(table["backlash_law"]).upper()]
        added = tuple(map(str, table.get("added", [])))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        said = str(error.args[0]) if error.args else type(error).__name__
        raise InputError(where, said, "effects of the registry with their parameters", "correct or remove the text") from None
    return Carried(effects, law, added)
