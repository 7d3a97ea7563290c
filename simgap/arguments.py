"""Types of arguments that commands share, and the checks of an output place.

A type says what a path is for: a recording or another file that is read, a folder or a file that is written. The form of the app
(`simgap.app.forms`) is made from these types.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

__all__ = [
    "Amount",
    "Choice",
    "InputFile",
    "InputPattern",
    "ModelFile",
    "NamedSource",
    "OutputFile",
    "OutputFolder",
    "complete_effects",
    "model_root",
    "need_file",
    "need_folder",
    "spare_inputs",
    "take_file",
    "take_folder",
]

ADVICE = "choose another --out"
_ROOTS = "SIMGAP_MODEL_ROOT"  # of `mjsim.mjcf.limits`, which a command line without a model does not import


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


def _completed(kind: str, incomplete: str, names: Iterable[str] = (), *endings: str) -> list[CompletionItem]:
    """The shell's own completion of files where a path begins so, else the names that do; ``kind``: file or dir.

    Of nothing typed yet: the names, and the files of these endings that stand here.
    """
    from click.shell_completion import CompletionItem

    folder, start = os.path.split(incomplete)
    fit = [n for n in names if n.startswith(incomplete)]
    with contextlib.suppress(OSError):
        there = sorted(n for n in os.listdir(folder or ".") if n.startswith(start))
        fit = [] if start and there else [n for n in there if fit and n.endswith(endings)] + fit
    return [CompletionItem(n) for n in fit] or [CompletionItem(incomplete, type=kind)]


def _shipped(*, models: bool, scenarios: bool) -> list[str]:
    names: list[str] = []
    if scenarios:
        from mjsim.robot.scenario import shipped_robot_scenarios
        from mjsim.scenario import shipped_scenarios

        names += [*shipped_scenarios(), *shipped_robot_scenarios()]
    if models:
        from mjsim.models import shipped_models

        names += shipped_models()
    return names


def complete_effects(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Identifiers of effects, after those that stand before the last comma."""
    from click.shell_completion import CompletionItem

    from mjsim.effects import registered

    before, comma, last = incomplete.rpartition(",")
    names = dict.fromkeys(cls.name() for cls in registered().values())
    return [CompletionItem(f"{before}{comma}{n}") for n in names if n.startswith(last)]


@final
class Amount(click.FloatRange):
    """A finite number in a range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number. Fails for one outside the range, for infinity, and for NaN, that compares with no bound."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is no finite number", param, ctx)
        return number


@final
class InputFile(click.ParamType):
    """A file that is read; converts to a Path.

    ``endings``: such as ``.json``; none: those of recordings, folders among them. ``usual``: the name that such a file has where
    a command wrote it.
    """

    name = "path"

    def __init__(self, *endings: str, usual: str = "") -> None:
        self.endings, self.usual = endings, usual

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path as it is; whether the file is there is for its reader to say."""
        return Path(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Files."""
        return _completed("file", incomplete)


@final
class InputPattern(click.ParamType):
    """A pattern of paths, such as ``logs/*/*.csv``; stays a string."""

    name = "text"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Files, from which a pattern is made."""
        return _completed("file", incomplete)


@final
class OutputFolder(click.ParamType):
    """A folder that is written to, made where it is missing; converts to a Path."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path as it is; see `need_folder`."""
        return Path(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Folders."""
        return _completed("dir", incomplete)


@final
class OutputFile(click.ParamType):
    """A file that is written; converts to a Path. ``endings``: those among which its name chooses the format."""

    name = "path"

    def __init__(self, *endings: str) -> None:
        self.endings = endings

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path as it is; see `need_file`."""
        return Path(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Files."""
        return _completed("file", incomplete)


@final
class NamedSource(click.ParamType):
    """A scenario by TOML file or shipped name, and with ``models`` also an MJCF file or a shipped model; stays a string."""

    name = "text"

    def __init__(self, *, models: bool = False) -> None:
        self.models = models

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Files, or shipped names."""
        return _completed("file", incomplete, _shipped(models=self.models, scenarios=True), ".toml", ".xml")


class ModelFile(click.ParamType):
    """An MJCF file, or a shipped model by name such as ``robot_axis1``; converts to a Path."""

    name = "model"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Path of the model. Raises InputError that names the shipped models for a name that is none."""
        from mjsim.models import model_path

        return model_path(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Files, or names of shipped models."""
        return _completed("file", incomplete, _shipped(models=True, scenarios=False), ".xml")


def model_root(command: Callable[..., Any]) -> Callable[..., Any]:
    """The option ``--model-root`` of a command: folders outside the model's own from which it may read, while the command runs.

    Workers that the command starts have them as well, by the environment variable `mjsim.mjcf.limits.ROOTS`.
    """

    def allow(context: click.Context, _: click.Parameter, folders: tuple[str, ...]) -> None:
        if not folders:
            return
        before = os.environ.get(_ROOTS)
        os.environ[_ROOTS] = os.pathsep.join([*map(os.path.abspath, folders), *([before] if before else [])])

        def restore() -> None:
            os.environ.pop(_ROOTS, None)
            if before is not None:
                os.environ[_ROOTS] = before

        context.call_on_close(restore)

    said = "A folder outside the model's own from which it may read meshes, textures and included files (repeatable)."
    folder = click.Path(exists=True, file_okay=False)
    option = click.option(
        "--model-root", type=folder, multiple=True, expose_value=False, is_eager=True, callback=allow, help=said
    )
    return option(command)


def need_folder(out: Path, advice: str = ADVICE) -> None:
    """Check that ``out`` is, or can become, a folder that can be written. Raises InputError."""
    from mjsim.errors import InputError

    there = next(p for p in (out, *out.absolute().parents) if os.path.lexists(p))
    if there.is_symlink() and not there.exists():
        raise InputError(out, f"{there.name!r} is a link that leads nowhere", "a folder", advice)
    if not there.is_dir():
        raise InputError(out, f"{there.name!r} is a file", "a folder", advice)
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(out, f"the folder {str(there)!r} cannot be written", "a writable place", advice)


def take_folder(out: Path, advice: str = ADVICE) -> None:
    """`need_folder`, and hold the folder until the command of the click context ends. Raises InputError where it is held."""
    need_folder(out, advice)
    _hold(out, "folder")


def need_file(out: Path, advice: str = ADVICE) -> None:
    """Check that a file can be written at ``out``, whose folder is made later where it is missing. Raises InputError."""
    from mjsim.errors import InputError

    if out.is_dir():
        raise InputError(out, "it is a folder", "the name of a file", advice)
    need_folder(out.parent, advice)


def take_file(out: Path, advice: str = ADVICE) -> None:
    """`need_file`, and hold the file until the command of the click context ends. Raises InputError where it is held."""
    need_file(out, advice)
    _hold(out, "file")


def _hold(out: Path, kind: str) -> None:
    """Hold an output place until the command of the click context ends."""
    from simgap.sole import sole

    context = click.get_current_context(silent=True)
    if context is not None:
        context.with_resource(sole(out, kind))


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
