"""What is checked of an MJCF file around its compilation: sizes and kinds of files before, finite numbers after."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np

from mjsim.errors import InputError

__all__ = ["MOST_COPIES", "MOST_KEYS", "need_finite", "need_sizes"]

MOST_COPIES = 10_000
"""Largest number of copies by nested ``<replicate>``: MuJoCo compiles so many bodies within seconds."""
MOST_KEYS = 10_000
"""Largest number of keyframes; the compiler's time grows with its square."""

_REPLICATE = re.compile(rb"</replicate\s*>|<replicate\b[^>]*?(/?)>")
_COUNT = re.compile(rb"""\bcount\s*=\s*["']\s*([0-9.eE+]+)""")
_FILE = re.compile(rb"""\bfile\s*=\s*["']([^"']+)["']""")
_FOLDER = re.compile(rb"""\b(?:meshdir|texturedir|assetdir)\s*=\s*["']([^"']+)["']""")
_NUMBERS = (
    "body_pos", "body_quat", "body_mass", "body_inertia", "jnt_pos", "jnt_axis", "jnt_stiffness", "jnt_range", "qpos0",
    "qpos_spring", "dof_damping", "dof_armature", "dof_frictionloss", "geom_pos", "geom_size", "actuator_gear",
    "actuator_gainprm",
    "actuator_biasprm", "actuator_dynprm", "tendon_stiffness", "tendon_damping", "tendon_frictionloss", "eq_data",
)  # fmt: skip


def need_sizes(path: Path) -> None:
    """Raise InputError for a file that expands beyond the limits, or that refers to something that is no regular file."""
    try:
        text = re.sub(rb"<!--.*?-->", b"", path.read_bytes(), flags=re.DOTALL)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "an MJCF model", "check the path") from None
    copies = _copies(text)
    if copies > MOST_COPIES:
        raise InputError(path, f"<replicate> makes {copies:.3g} copies", f"at most {MOST_COPIES}", "lower its count")
    keys = len(re.findall(rb"<key\b", text))
    if keys > MOST_KEYS:
        raise InputError(path, f"{keys} keyframes", f"at most {MOST_KEYS}", "remove those that are not needed")
    folders = [path.parent, *(path.parent / found.decode(errors="replace") for found in _FOLDER.findall(text))]
    for name in _FILE.findall(text):
        for folder in folders:
            file = folder / name.decode(errors="replace")
            if file.exists() and not file.is_file():
                raise InputError(path, f"{str(file)!r} is not a regular file", "a file", "name a file")


def _copies(text: bytes) -> float:
    """The largest product of the counts of nested elements."""
    nested, largest = [1.0], 1.0
    for found in _REPLICATE.finditer(text):
        if found.group().startswith(b"</"):
            if len(nested) > 1:
                nested.pop()
            continue
        count = _COUNT.search(found.group())
        try:
            product = nested[-1] * (float(count.group(1)) if count else 1.0)
        except ValueError:
            continue  # MuJoCo names it
        largest = max(largest, product)
        if not found.group(1):
            nested.append(product)
    return largest


def need_finite(model: mujoco.MjModel, path: Path) -> None:
    """Raise InputError where a number of the compiled model is not finite: MuJoCo accepts NaN and steps it."""
    for name in _NUMBERS:
        bad = np.argwhere(~np.isfinite(getattr(model, name)))
        if len(bad):
            raise InputError(path, f"{name}[{', '.join(map(str, bad[0]))}] is not finite", "a number", "correct the attribute")
