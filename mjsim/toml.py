"""TOML files beside recordings and models, read with one clear line for what is none."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

from mjsim.errors import InputError

__all__ = ["MOST_BYTES", "lies_at", "toml_at", "toml_of"]

MOST_BYTES = 2**20
"""Largest size of a TOML file [bytes]."""


def lies_at(path: Path) -> bool:
    """Whether there is a file. Raises InputError for a folder, a pipe, or a link that leads nowhere: it is not read as none."""
    if path.is_file():
        return True
    if os.path.lexists(path):
        raise InputError(path, "not a regular file", "a TOML file, or none of this name", "remove it, or mend the link")
    return False


def toml_at(path: Path) -> dict[str, Any]:
    """The table of a TOML file. Raises InputError."""
    try:
        with path.open("rb") as file:
            raw = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "a TOML file", "check the path") from None
    if len(raw) > MOST_BYTES:
        raise InputError(path, f"it has more than {MOST_BYTES} bytes", "a smaller TOML file", "check that it is the right file")
    try:
        return toml_of(raw.decode("utf-8"), path)
    except UnicodeDecodeError as error:
        raise InputError(path, f"not valid TOML ({error})", "a TOML file", "correct it") from None


def toml_of(text: str, source: object) -> dict[str, Any]:
    """The table of a TOML text; ``source``: how messages name it. Raises InputError."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(source, "not valid TOML (nested too deep)", "a TOML file", "correct it") from None
    except ValueError as error:  # TOMLDecodeError, and a number of more digits than Python reads
        said = str(error).split("; use sys")[0]
        raise InputError(source, f"not valid TOML ({said})", "a TOML file", "correct it") from None
