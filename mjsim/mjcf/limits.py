"""What is checked of an MJCF file around its compilation: sizes and kinds of files before, finite numbers after."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np

from mjsim.errors import InputError

__all__ = ["MOST_BYTES", "MOST_COPIES", "MOST_FILES", "MOST_KEYS", "need_finite", "need_sizes"]

MOST_COPIES = 10_000
"""Largest number of copies by nested ``<replicate>``: MuJoCo compiles so many bodies within seconds."""
MOST_KEYS = 10_000
"""Largest number of keyframes; the compiler's time grows with its square."""

MOST_FILES = 200
"""Largest number of ``<include>`` elements, those of included files among them."""
MOST_BYTES = 2**26
"""Largest size of a model with all files that it includes [bytes]."""

_INCLUDE = re.compile(rb"""<include\b[^>]*?\bfile\s*=\s*["']([^"']+)["'][^>]*?>""")
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
    """Raise InputError for a file that expands beyond the limits, with all that it includes.

    As well for one that refers to something that is no regular file, or includes a file outside its own folder.
    """
    text = _expanded(path, path, [], [0, 0])
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


def _expanded(path: Path, model: Path, within: list[Path], read: list[int]) -> bytes:
    """The text of a file without comments, its includes replaced by what they include.

    within: the files that include this one; read: how many files and bytes so far. What is missing, and a file that includes
    itself, are left to MuJoCo, which names them.
    """
    try:
        text = re.sub(rb"<!--.*?-->", b"", path.read_bytes(), flags=re.DOTALL)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "an MJCF model", "check the path") from None
    read[0] += 1
    read[1] += len(text)
    if read[0] > MOST_FILES + 1 or read[1] > MOST_BYTES:
        most = f"{MOST_FILES} files or {MOST_BYTES / 2**20:.3g} MB"
        raise InputError(model, f"it includes more than {most}", "a smaller model", "merge the files")

    def included(found: re.Match[bytes]) -> bytes:
        name = found.group(1).decode(errors="replace")
        for folder in dict.fromkeys((model.parent, path.parent)):
            file = folder / name
            if not file.exists():
                continue
            if not file.resolve().is_relative_to(model.parent.resolve()):
                raise InputError(model, f"it includes {name!r} outside its folder", "a file beside it", "copy it there")
            if not file.is_file():
                raise InputError(model, f"{str(file)!r} is not a regular file", "a file", "name a file")
            return found.group() if file in (*within, path) else _expanded(file, model, [*within, path], read)
        return found.group()

    return _INCLUDE.sub(included, text)


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
