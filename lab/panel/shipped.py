"""The shipped models as files of a case: what a commit changes of them would change the case."""

from __future__ import annotations

import shutil
from pathlib import Path

from mjsim.models import shipped_model

__all__ = ["copy_model"]


def copy_model(name: str, folder: Path) -> str:
    """Copy a shipped model and its binding; the name of the copy."""
    source = shipped_model(name)
    for path in (source, source.with_suffix(".toml")):
        shutil.copyfile(path, folder / path.name)
    return source.name
