"""Recordings that are not part of the project: where a local copy is looked for."""

from __future__ import annotations

import os
from pathlib import Path

from mjsim.errors import InputError

__all__ = ["local_copy"]


def local_copy(folder: str, file: str) -> Path:
    """A file of a local copy, under the folder that SIMGAP_DATA names, else in ``shared`` beside the checkout.

    Raises InputError where it is in none of these places.
    """
    beside = Path(__file__).resolve().parents[3] / "shared"
    given = os.environ.get("SIMGAP_DATA")
    for top in (Path(given) if given else beside, beside):
        for path in (top / folder / file, top / "real" / folder / file, top / file):
            if path.is_file():
                return path
    raise InputError(f"{folder}/{file}", "no local copy", "the folder that holds it", "set SIMGAP_DATA to it")
