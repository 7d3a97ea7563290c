"""A model that spreads over several files, or whose elements have no names, as one file in which every element has one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.mjcf.assets import copy_file
from mjsim.mjcf.compile import compile_file, read_spec, save_compiled
from mjsim.mjcf.tags import with_plain_comments

__all__ = ["WRITTEN", "is_whole", "write_whole"]

WRITTEN = "nominal.xml"  # in the folder of a diagnosis, where the user's model is not one file with named elements

KINDS = ("body", "joint", "actuator", "tendon", "equality", "sensor")
TREE = {"body": "body", "joint": "joint", "freejoint": "joint"}
SECTIONS = {"actuator": "actuator", "tendon": "tendon", "equality": "equality", "sensor": "sensor"}
FOLDERS = ("assetdir", "meshdir", "texturedir")
DEEPEST = 20  # files that include one another
SAME = (
    "qpos0", "body_mass", "body_inertia", "body_ipos", "body_pos", "jnt_range", "jnt_stiffness", "dof_armature", "dof_damping",
    "dof_frictionloss", "dof_solref", "dof_solimp", "actuator_gainprm", "actuator_biasprm", "actuator_gear", "eq_data",
    "tendon_stiffness",
)  # fmt: skip
"""Arrays of a compiled model that must be the same in both files."""


def is_whole(path: Path) -> bool:
    """Whether a correction can be written into the file as it is: no included file, and every element of a chain named.

    True for a file that is not MJCF as well: what reads it says so.
    """
    try:
        root = read_spec(path)
        text = path.read_bytes()
    except (ValueError, OSError):
        return True
    return b"<include" not in text and all(e.name for kind in KINDS for e in _elements(root, kind))


def _elements(spec: mujoco.MjSpec, kind: str) -> list[mujoco.MjsElement]:
    plural = {"body": "bodies", "equality": "equalities"}.get(kind, f"{kind}s")
    return list(getattr(spec, plural))


def write_whole(path: Path, out: Path) -> Path:
    """Write the model of ``path`` as one file with all elements named; returns ``out``.

    Included files take the place of their ``<include>``; every number and comment is kept as it is written, but for ``--`` in a
    comment, which becomes ``==``. Files of meshes and textures stay where they are; the TOML file beside the model goes with it.
    Raises InputError where the written file is not the same model, OSError where it cannot be written.
    """
    before = compile_file(path)
    try:
        root = _merged(path, path.resolve().parent)
        _name_elements(root)
        _keep_folders(root, path.resolve().parent, out.resolve().parent)
        save_compiled(ElementTree.tostring(root, encoding="utf-8"), out)
        if path.with_suffix(".toml").is_file():
            copy_file(path.with_suffix(".toml"), out.with_suffix(".toml"))
        after = compile_file(out)
    except InputError as error:
        raise InputError(path, f"as one file it does not load ({error})", "one file with named elements", "merge it") from None
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(
            path, f"it cannot be written as one file ({error})", "one file with named elements", "merge it"
        ) from None
    for name in SAME:
        a, b = getattr(before, name), getattr(after, name)
        if a.shape != b.shape or not np.allclose(a, b, rtol=1e-12, atol=0.0):
            raise InputError(
                path, f"as one file it is another model ({name})", "one file with named elements", "merge it and name them"
            )
    return out


def _merged(path: Path, folder: Path, depth: int = 0) -> ElementTree.Element:
    """The elements of a file, with those of the files that it includes in their places. ``folder``: that of the main file."""
    if depth > DEEPEST:
        raise ValueError(f"files include one another more than {DEEPEST} deep")
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    parser.feed(with_plain_comments(path.read_bytes(), path))
    root = parser.close()
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag == "include":
                at = list(parent).index(child)
                parent.remove(child)
                name = child.get("file", "")
                found = next((f for f in (path.resolve().parent / name, folder / name) if f.is_file()), None)
                if found is None:
                    raise ValueError(f"it includes {name}, which is not there")
                for offset, element in enumerate(_merged(found, folder, depth + 1)):
                    parent.insert(at + offset, element)
    return root


def _name_elements(root: ElementTree.Element) -> None:
    """Give every element of a chain that has no name one of its own: its kind and a number."""
    elements = list(_chain(root))
    taken = {(kind, e.get("name")) for kind, e in elements}
    counts: dict[str, int] = {}
    for kind, element in elements:
        while not element.get("name"):
            name = f"{kind}{counts.get(kind, 0)}"
            counts[kind] = counts.get(kind, 0) + 1
            if (kind, name) not in taken:
                element.set("name", name)


def _chain(root: ElementTree.Element) -> Iterator[tuple[str, ElementTree.Element]]:
    """(kind, element) of all elements that MuJoCo counts by kind, in the order of the text."""
    for section in root:
        if section.tag == "worldbody":
            for element in section.iter():
                if element.tag in TREE:
                    yield TREE[element.tag], element
        elif section.tag in SECTIONS:
            for element in section:
                if isinstance(element.tag, str):  # a comment's is a function
                    yield SECTIONS[section.tag], element


def _keep_folders(root: ElementTree.Element, here: Path, there: Path) -> None:
    """Let relative paths of meshes and textures lead from ``there`` to where they led from ``here``."""
    compilers = root.findall("compiler")
    for compiler in compilers:
        for key in FOLDERS:
            if key in compiler.attrib:
                compiler.set(key, os.path.relpath(here / compiler.attrib[key], there))
    if not any(key in c.attrib for c in compilers for key in FOLDERS):
        compiler = compilers[0] if compilers else ElementTree.Element("compiler")
        if not compilers:
            root.insert(0, compiler)
        compiler.set("assetdir", os.path.relpath(here, there))
