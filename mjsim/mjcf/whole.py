"""A model that spreads over several files, or whose elements have no names, as one file in which every element has one."""

from __future__ import annotations

import os
from pathlib import Path
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.mjcf.compile import compile_file

__all__ = ["WRITTEN", "is_whole", "write_whole"]

WRITTEN = "nominal.xml"  # in the folder of a diagnosis, where the user's model is not one file with named elements

KINDS = ("body", "joint", "actuator", "tendon", "equality", "sensor")
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
        root = mujoco.MjSpec.from_file(str(path))
        text = path.read_bytes()
    except (ValueError, OSError):
        return True
    return b"<include" not in text and all(e.name for kind in KINDS for e in _elements(root, kind))


def _elements(spec: mujoco.MjSpec, kind: str) -> list[mujoco.MjsElement]:
    plural = {"body": "bodies", "equality": "equalities"}.get(kind, f"{kind}s")
    return list(getattr(spec, plural))


def write_whole(path: Path, out: Path) -> Path:
    """Write the model of ``path`` as one file with all elements named, as MuJoCo's own writer has it; returns ``out``.

    Files of meshes and textures stay where they are; the TOML file beside the model goes with it. Raises InputError where the
    written file is not the same model.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise InputError(path, f"MuJoCo cannot read it ({error})", "an MJCF file", "correct it") from None
    for kind in KINDS:
        elements = _elements(spec, kind)
        taken = {e.name for e in elements}
        for index, e in enumerate(elements):
            if not e.name:
                name = f"{kind}{index}"
                while name in taken:
                    name += "_"
                e.name = name
                taken.add(name)
    here, there = path.resolve().parent, out.resolve().parent
    folders = {key: here / getattr(spec, key) for key in ("meshdir", "texturedir")}
    try:
        for key, folder in folders.items():
            setattr(spec, key, str(folder))
        spec.compile()
        text = spec.to_xml()
        for key, folder in folders.items():
            text = text.replace(f"{key}={quoteattr(str(folder))}", f"{key}={quoteattr(os.path.relpath(folder, there))}")
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")
        if path.with_suffix(".toml").is_file():
            out.with_suffix(".toml").write_bytes(path.with_suffix(".toml").read_bytes())
        again, before = compile_file(out), compile_file(path)
    except ValueError as error:
        raise InputError(
            path, f"it cannot be written as one file ({error})", "one file with named elements", "merge it"
        ) from None
    for name in SAME:
        a, b = getattr(before, name), getattr(again, name)
        if a.shape != b.shape or not np.allclose(a, b, rtol=1e-6, atol=1e-9):
            raise InputError(
                path,
                f"MuJoCo writes another model ({name}) as one file",
                "one file with named elements",
                "merge it and name them",
            )
    return out
