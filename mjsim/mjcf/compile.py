"""Compiling MJCF without side effects: warnings are caught and named, nothing is printed, no MUJOCO_LOG.TXT is left behind."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco

from mjsim.errors import InputError, nearest_file, writing
from mjsim.mjcf.limits import need_finite, need_sizes

__all__ = ["caught_warnings", "compile_file", "read_spec", "save_compiled"]


@contextlib.contextmanager
def caught_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings in a list while the block runs; without this they go to the terminal and to a log file."""
    caught: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: caught.append(str(message).strip()))
    try:
        yield caught
    finally:
        mujoco.set_mju_user_warning(before)


def compile_file(path: str | Path) -> mujoco.MjModel:
    """Compile an MJCF file; what MuJoCo says when it does not load becomes one line that names the file."""
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "no such file", "an MJCF model (.xml)", nearest_file(path, ".xml"))
    need_sizes(path)
    try:
        with caught_warnings():
            model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(path, f"MuJoCo does not load it ({said})", "an MJCF model", "correct the element it names") from None
    for name in model.names.split(b"\0"):
        try:
            name.decode("utf-8")
        except UnicodeDecodeError:
            raise InputError(path, f"the name {name!r} is not UTF-8", "UTF-8", "save the model as UTF-8") from None
    need_finite(model, path)
    return model


def read_spec(path: Path) -> mujoco.MjSpec:
    """The specification of an MJCF file, its limits checked. Raises InputError, and ValueError where MuJoCo does not read it."""
    need_sizes(path)
    return mujoco.MjSpec.from_file(str(path))


def save_compiled(content: bytes, out: Path, load: Callable[[Path], object] = compile_file) -> None:
    """Write a file beside its final name, load it, then move it there: what does not load is not left behind.

    Raises what ``load`` does, and OSError where the file cannot be written.
    """
    part = out.with_name(f".{out.name}.part.xml")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with writing(out):
            part.write_bytes(content)
        load(part)
        os.replace(part, out)
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
