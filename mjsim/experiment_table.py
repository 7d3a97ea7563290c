"""The table ``[experiment]`` of a binding: the names of its keys, for one joint and for robots alike.

``loop``, ``judge``, ``varies``: how one joint is judged. ``kp``, ``kv``: known gains of its servo. ``supply_V``: supply voltage.
``payload``: a known mass on a robot (`mjsim.robot.binding`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from mjsim.errors import InputError, nearest

__all__ = [
    "CHANNEL_KEYS",
    "EXPERIMENT_KEYS",
    "TABLES",
    "need_known",
    "need_known_experiment",
    "need_no_misspelt_table",
    "need_no_model_table",
    "table_of",
]

EXPERIMENT_KEYS = ("loop", "judge", "varies", "kp", "kv", "supply_V", "payload")

CHANNEL_KEYS = ("column", "unit", "gain", "row")
TABLES = ("recording", "experiment", "joints", "model")

OTHERWISE = {
    "mass": "on a robot use payload = {body, mass, pos}; of one joint set the mass in the model",
    "inertia": "set it in the model",
}


def need_known(given: Collection[str], known: Collection[str], where: str, otherwise: Mapping[str, str] | None = None) -> None:
    """Raise InputError for a key that is not known, with the nearest known one, or the advice in ``otherwise``."""
    for key in given:
        if key not in known:
            advice = (otherwise or {}).get(key) or nearest(key, known, "rename or remove it")
            raise InputError(where, f"key {key!r} is not known", ", ".join(known), advice)


def table_of(tables: Mapping[str, Any], key: str, path: object) -> dict[str, Any]:
    """The table of this name, empty where there is none. Raises InputError where the value is no table."""
    value = tables.get(key, {})
    if not isinstance(value, dict):
        raise InputError(f"{path}: {key}", f"{value!r}", f"a table [{key}]", "correct it")
    return value


def need_no_misspelt_table(tables: Collection[str], path: object) -> None:
    """Raise InputError for a table that is not one of `TABLES` and resembles one; other tables are another program's."""
    for name in tables:
        if name not in TABLES and (advice := nearest(name, TABLES, "")):
            raise InputError(path, f"table [{name}] is not known", ", ".join(f"[{t}]" for t in TABLES), advice)


def need_no_model_table(tables: Collection[str], path: Path) -> None:
    """Raise InputError for a table ``[model]`` beside a recording; it is read from the file of the model's name only."""
    if "model" in tables and not path.with_suffix(".xml").is_file():
        raise InputError(path, "[model] is not read beside a recording", "[model] beside MODEL.xml", "move it to MODEL.toml")


def need_known_experiment(given: Mapping[str, Any], path: object) -> None:
    """Raise InputError for a key of ``[experiment]`` that is not known; ``path``: how messages name the file."""
    need_known(given, EXPERIMENT_KEYS, f"{path}: [experiment]", OTHERWISE)
