"""Print the lowest versions that pyproject.toml declares, as constraints for pip: name==version, one a line.

``make lowest`` installs them into an environment of their own and runs the quick tests there.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PYPROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"
BOUND = re.compile(r"^(?P<name>[\w-]+)(\[[\w,]+\])?>=(?P<version>[\w.]+)")
EXTRAS = ("formats", "fleet", "app")


def lowest(text: str) -> list[str]:
    """Constraints of the core and of the extras that users install."""
    project = tomllib.loads(text)["project"]
    wanted = [*project["dependencies"], *(d for e in EXTRAS for d in project["optional-dependencies"][e])]
    found = [BOUND.match(d) for d in wanted]
    return list(dict.fromkeys(f"{m['name']}=={m['version']}" for m in found if m is not None))


if __name__ == "__main__":
    print("\n".join(lowest(PYPROJECT.read_text(encoding="utf-8"))))
