"""Packages that read optional formats."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from mjsim.errors import InputError

__all__ = ["need"]


def need(package: str, path: Path) -> Any:
    """Import an optional package, or raise InputError that says how to install it."""
    try:
        return importlib.import_module(package)
    except ImportError:
        top = package.partition(".")[0]
        raise InputError(
            path, f"the Python package {top!r} for this format is not installed", "it", "pip install 'simgap[formats]'"
        ) from None
