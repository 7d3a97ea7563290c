"""Arguments that several commands share: a model by path or shipped name, and the checks of an output place."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

__all__ = ["Choice", "ModelFile", "need_file", "need_folder", "spare_inputs"]

ADVICE = "choose another --out"


class Choice(click.Choice):
    """One of some names; another is told with the nearest of them."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The name as it is declared. Raises click.BadParameter."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            from mjsim.errors import nearest

            told = nearest(str(value), self.choices, "")
            said = f"{error.message.rstrip('.')}; {told}" if told else error.message
            raise click.BadParameter(said, ctx, param) from None


class ModelFile(click.ParamType):
    """An MJCF file, or a shipped model by name such as ``robot_axis1``; converts to a Path."""

    name = "model"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Path of the model. Raises InputError that names the shipped models for a name that is none."""
        from mjsim.models import model_path

        return model_path(value)


def need_folder(out: Path, advice: str = ADVICE) -> None:
    """Check that ``out`` is, or can become, a folder that can be written. Raises InputError."""
    from mjsim.errors import InputError

    there = next(p for p in (out, *out.absolute().parents) if os.path.lexists(p))
    if not there.is_dir():
        raise InputError(out, f"{there.name!r} is a file", "a folder", advice)
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(out, f"the folder {str(there)!r} cannot be written", "a writable place", advice)


def need_file(out: Path, advice: str = ADVICE) -> None:
    """Check that a file can be written at ``out``, whose folder is made later where it is missing. Raises InputError."""
    from mjsim.errors import InputError

    if out.is_dir():
        raise InputError(out, "it is a folder", "the name of a file", advice)
    need_folder(out.parent, advice)


def spare_inputs(outputs: Iterable[Path], inputs: Iterable[Path | None], option: str = "--out") -> None:
    """Check that no output takes the place of a file that the command reads. Raises InputError.

    Two paths are the same file when they resolve to one path or to one inode (links).
    """
    from mjsim.errors import InputError

    read = [p for p in inputs if p is not None]
    for out in outputs:
        for path in read:
            linked = out.exists() and path.exists() and os.path.samefile(out, path)
            if linked or out.resolve() == path.resolve():
                raise InputError(option, f"{str(out)!r} would overwrite the input {str(path)!r}", "another place", "rename it")
