"""The wheel holds one import package: ``mjsim``, ``ident``, ``diagnose`` and ``lab`` are installed under ``simgap/_src``.

In the source tree they are top-level packages. Other distributions use these names (docs/decisions/one-package.md), so the wheel
must not. The build copies the sources and rewrites every import of them; an editable install keeps the source tree as it is.
"""

from __future__ import annotations

import ast
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGES = ("mjsim", "ident", "diagnose", "lab")
INSIDE = "simgap._src"
LEFT_OUT = ("lab/panel", "lab/speed", "lab/first_use.py")  # they measure the source tree
MODULE = re.compile(rf"({'|'.join(PACKAGES)})(\.[A-Za-z_]\w*)+")


class BuildHook(BuildHookInterface[Any]):
    """Puts the rewritten sources into a wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before a wheel is built; ``version`` is "editable" for an editable install."""
        if version == "editable":
            return
        self._scratch = tempfile.mkdtemp(prefix="simgap-wheel-")
        lay_out(Path(self.root), Path(self._scratch) / "simgap")
        build_data["force_include"][str(Path(self._scratch) / "simgap")] = "simgap"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the copy."""
        if version != "editable":
            shutil.rmtree(self._scratch, ignore_errors=True)


def lay_out(root: Path, out: Path) -> None:
    """Write the package as it is installed: simgap, the others in ``_src``, the shipped models."""
    for name, target in (("simgap", out), *((p, out / "_src" / p) for p in PACKAGES)):
        for path in sorted((root / name).rglob("*")):
            relative = path.relative_to(root).as_posix()
            if not path.is_file() or "__pycache__" in path.parts or relative.startswith(LEFT_OUT):
                continue
            copy = target / path.relative_to(root / name)
            copy.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix == ".py":
                copy.write_text(rewritten(path.read_text(encoding="utf-8"), relative), encoding="utf-8")
            else:
                shutil.copyfile(path, copy)
    (out / "_src" / "__init__.py").write_text('"""What simgap is made of; the names for users are those of `simgap`."""\n')
    shutil.copytree(root / "models", out / "models")


def rewritten(text: str, name: str = "<string>") -> str:
    """A module whose imports of the four packages, and strings that are dotted names in them, name the installed place."""
    lines = [line.encode() for line in text.splitlines(keepends=True)]
    tree = ast.parse(text, name)
    edits = [edit for node in ast.walk(tree) if (edit := _edit(node, lines)) is not None]
    for row, start, end, new in sorted(edits, reverse=True):
        lines[row] = lines[row][:start] + new.encode() + lines[row][end:]
    return b"".join(lines).decode()


def _edit(node: ast.AST, lines: list[bytes]) -> tuple[int, int, int, str] | None:
    """(row, first byte, last byte, text) that takes the place of a part of a node; None where nothing is to be changed."""
    if isinstance(node, ast.ImportFrom):
        if node.level or node.module is None or node.module.partition(".")[0] not in PACKAGES:
            return None
        row = node.lineno - 1
        start = lines[row].index(node.module.encode(), node.col_offset + len("from "))
        return row, start, start + len(node.module), f"{INSIDE}.{node.module}"
    if isinstance(node, ast.Import):
        if not any(a.name.partition(".")[0] in PACKAGES for a in node.names):
            return None
        if node.lineno != node.end_lineno:
            raise ValueError(f"an import over several lines: {ast.unparse(node)}")
        return node.lineno - 1, node.col_offset, node.end_col_offset or 0, "; ".join(_import(a) for a in node.names)
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and MODULE.fullmatch(node.value):
        return node.lineno - 1, node.col_offset, node.end_col_offset or 0, repr(f"{INSIDE}.{node.value}")
    return None


def _import(alias: ast.alias) -> str:
    """An import statement of one name that binds what the original binds."""
    top, _, rest = alias.name.partition(".")
    if top not in PACKAGES:
        return ast.unparse(ast.Import([alias]))
    if alias.asname:
        return f"import {INSIDE}.{alias.name} as {alias.asname}"
    bind = f"from {INSIDE} import {top}"
    return f"import {INSIDE}.{alias.name}; {bind}" if rest else bind
