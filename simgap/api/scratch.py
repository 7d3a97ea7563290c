"""`Scratch`: a temporary folder that lasts as long as the objects that hold it."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from pathlib import Path
from typing import final

__all__ = ["Scratch"]


@final
class Scratch:
    """A temporary folder; it is removed with this object, or when the interpreter ends."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="simgap-"))
        self._end = weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)
