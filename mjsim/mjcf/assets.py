"""The files that a written model refers to: paths that lead to them from another folder, or copies beside the model."""

from __future__ import annotations

import contextlib
import filecmp
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from mjsim.errors import writing
from mjsim.mjcf.compile import save_compiled
from mjsim.mjcf.limits import FOLDERS, NESTED
from mjsim.mjcf.xmltext import Node, XmlText

__all__ = ["BESIDE", "bring_assets", "copy_file", "placed", "relocate"]

BESIDE = "simgap_assets"  # folder of the copies


def relocate(xml: XmlText, source: Path, out: Path) -> None:
    """Change the relative paths of the text of ``source`` so that they lead to the same files from the folder of ``out``."""
    here, there = source.resolve().parent, out.resolve().parent
    if here == there:
        return
    relative = Path(os.path.relpath(here, there))
    for include in [n for n in xml.root.walk() if n.tag == "include" and "file" in n.attributes]:
        xml.set(include, "file", str(relative / include.attributes["file"]))
    if any(_names(n) for n in xml.root.walk()):
        found = _compiler(xml).attributes
        _set_folders(xml, {k: os.path.normpath(relative / found.get(k, ".")) for k in FOLDERS if k == "assetdir" or k in found})


def bring_assets(path: Path) -> None:
    """Copy the meshes and textures of a model to the folder `BESIDE` beside it, where any of them stands outside its folder.

    The model then loads wherever its folder is moved, and reads nothing outside. Files of the same name keep it, each in a folder
    of its own. Raises InputError where the model does not load afterwards, OSError where a copy cannot be written.
    """
    xml, home = XmlText.read(path), path.resolve().parent
    files = {(i, key): _place(xml, node, key, home) for i, node in enumerate(xml.root.walk()) for key in _names(node)}
    if all(f is None or f.is_relative_to(home) for f in files.values()):
        return
    names: dict[Path, str] = {}
    for file in files.values():
        if file is not None and file not in names:
            number = sum(other.name == file.name for other in names)
            names[file] = f"{number}/{file.name}" if number else file.name
            copy_file(file, home / BESIDE / names[file])
    for (i, key), file in files.items():
        if file is not None:
            xml.set(list(xml.root.walk())[i], key, names[file])
    _set_folders(xml, {k: BESIDE for k in FOLDERS if k == "assetdir" or k in _compiler(xml).attributes} | {"strippath": None})
    save_compiled(xml.raw, path)


def _names(node: Node) -> list[str]:
    """Attributes of an element that name a mesh, texture, height field or skin."""
    return [k for k in node.attributes if k.startswith("file") and node.tag not in NESTED]


def _place(xml: XmlText, node: Node, key: str, home: Path) -> Path | None:
    """The file that an attribute names, None where it is not there."""
    compiler = xml.root.child("compiler")
    options = compiler.attributes if compiler is not None else {}
    folder = options.get("texturedir" if node.tag == "texture" else "meshdir", options.get("assetdir", "."))
    name = node.attributes[key].replace("\\", "/")
    if options.get("strippath") == "true":
        name = os.path.basename(name)
    file = Path(os.path.normpath(home / folder.replace("\\", "/") / name))
    return file.resolve() if file.is_file() else None


def _compiler(xml: XmlText) -> Node:
    """The compiler element, added where there is none."""
    if xml.root.child("compiler") is None:
        if xml.root.children:
            xml.insert_before(xml.root.children[0], ["<compiler/>"])
        else:
            xml.append(xml.root, ["<compiler/>"])
    node = xml.root.child("compiler")
    assert node is not None
    return node


def _set_folders(xml: XmlText, values: dict[str, str | None] | dict[str, str]) -> None:
    for key, value in values.items():
        xml.set(_compiler(xml), key, value)


@contextlib.contextmanager
def placed(path: Path) -> Iterator[Path]:
    """A name beside ``path`` under which a model is written; at the end its assets are brought and it is moved to ``path``.

    Where the block raises, nothing is left; what stood at ``path`` stays.
    """
    part = path.with_name(f".{path.stem}.part.xml")
    try:
        yield part
        bring_assets(part)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def copy_file(file: Path, to: Path) -> None:
    """Copy a file in one move; one that is there and the same is left. Raises OSError."""
    if to.is_file() and filecmp.cmp(file, to, shallow=False):
        return
    to.parent.mkdir(parents=True, exist_ok=True)
    part = to.with_name(f".{to.name}.part")
    try:
        with writing(to):
            shutil.copyfile(file, part)
        os.replace(part, to)
    finally:
        part.unlink(missing_ok=True)
