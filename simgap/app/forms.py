"""Forms from the command line: the parameters of a command as fields, and filled-in fields as words of a command line.

A field is made from the type of a parameter (see `simgap.arguments`). An output goes to the folder of the command in the run and
is no field. A command whose required parameters cannot be bound to a run has no form.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any

import click

from mjsim.errors import InputError, nearest
from simgap.arguments import InputFile, InputPattern, ModelFile, NamedSource, OutputFile, OutputFolder
from simgap.cli import COMMANDS, cli

__all__ = ["Field", "Form", "Kind", "form_of", "forms"]

LONGEST_TEXT = 1000  # characters of a field
PATTERN = "recordings/*"  # what a pattern of paths means in a run
FORMAT = "format"  # name of the field that chooses the ending of the file that is written
_PRINTED = {"as_json", "quiet", "listing"}  # parameters that change what is printed, by their name
_ELSEWHERE = {"app"}


class Kind(Enum):
    """What a field asks for."""

    MODEL = "model"
    RECORDING = "recording"
    FILE = "file"
    SOURCE = "source"
    CHOICE = "choice"
    FLAG = "flag"
    WHOLE = "whole"
    NUMBER = "number"
    TEXT = "text"


@dataclass(frozen=True)
class Field:
    """A parameter: its name, option (empty: a positional argument), what the form calls it, help, kind and limits.

    ``endings``: of the files that it takes; ``usual``: the name of such a file; ``models``: whether a source may be a model.
    """

    name: str
    option: str
    label: str
    help: str
    kind: Kind
    required: bool = False
    several: bool = False
    default: Any = None
    choices: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None
    endings: tuple[str, ...] = ()
    usual: str = ""
    models: bool = False

    def checked(self, value: Any) -> Any:
        """The value in the field's type; None for an empty one. Raises InputError, naming the field."""
        if value is None or value == "" or value == []:
            return None
        if self.kind is Kind.FLAG:
            self._need(isinstance(value, bool), value, "true or false")
            return value or None
        if self.kind in (Kind.WHOLE, Kind.NUMBER):
            return self._number(value)
        good = isinstance(value, str) and len(value) <= LONGEST_TEXT and value.isprintable()
        self._need(good, value, f"at most {LONGEST_TEXT} printable characters")
        text = str(value).strip()
        if self.kind is Kind.CHOICE and text not in self.choices:
            raise InputError(self.label, f"{text!r:.80}", f"one of: {', '.join(self.choices)}", nearest(text, self.choices))
        return text or None

    def _need(self, holds: bool, value: Any, expected: str) -> None:
        if not holds:
            raise InputError(self.label, f"{value!r:.40}", expected)

    def _number(self, value: Any) -> float | int:
        good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        limits = [f"{word} {x:g}" for word, x in (("at least", self.low), ("at most", self.high)) if x is not None]
        kind = "a whole number" if self.kind is Kind.WHOLE else "a number"
        expected = f"{kind}, {' and '.join(limits)}" if limits else kind
        low, high = self.low if self.low is not None else -(2.0**53), self.high if self.high is not None else 2.0**53
        self._need(good and low <= value <= high, value, expected)
        self._need(self.kind is Kind.NUMBER or value == int(value), value, expected)
        return int(value) if self.kind is Kind.WHOLE else float(value)


@dataclass(frozen=True)
class Form:
    """The form of a command: one line, the description of its help, the fields, and the option of its output.

    ``output`` is empty for a command that writes no files; ``formats``: endings of the file that it writes, empty for a folder.
    """

    command: str
    short: str
    about: tuple[str, ...]
    fields: tuple[Field, ...]
    output: str = ""
    formats: tuple[str, ...] = ()

    def field(self, name: str) -> Field:
        """A field by name. Raises InputError with the nearest name."""
        for f in self.fields:
            if f.name == name:
                return f
        known = [f.name for f in self.fields]
        raise InputError(f"setting {name!r:.80}", "unknown", f"one of: {', '.join(known)}", nearest(name, known))

    def checked(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The values that differ from nothing, in the types of their fields. Raises InputError."""
        found = {name: self.field(name).checked(value) for name, value in values.items()}
        return {name: value for name, value in found.items() if value is not None}

    def words(self, values: Mapping[str, Any], files: Mapping[str, Sequence[str]], out: str) -> list[str]:
        """The words of the command line after ``simgap``.

        ``files``: what the fields of files hold, by name; ``out``: the folder of the command, relative to that of the run.
        No value is taken for an option: options have the form ``--name=value``, arguments come after ``--``.
        """
        options, arguments = [], []
        for f in (f for f in self.fields if f.name != FORMAT):
            given = list(files[f.name]) if f.name in files else self._texts(f, values.get(f.name))
            if f.kind is Kind.FLAG:
                options += [f.option] * bool(values.get(f.name))
            elif f.option:
                options += [f"{f.option}={text}" for text in given]
            else:
                arguments += given
        if self.output:
            options.append(f"{self.output}={self._target(values, out)}")
        return [self.command, *options, *(["--", *arguments] if arguments else [])]

    def _target(self, values: Mapping[str, Any], out: str) -> str:
        return out if not self.formats else f"{out}/{self.command}{values.get(FORMAT, self.formats[0])}"

    @staticmethod
    def _texts(f: Field, value: Any) -> list[str]:
        if value is None:
            return []
        if f.several:
            return [part.strip() for part in str(value).split(",") if part.strip()]
        return [repr(value) if isinstance(value, float) else str(value)]


@cache
def forms() -> dict[str, Form]:
    """Command -> form, of all commands that work on what a run holds, in the order of the command line."""
    found = {name: form_of(name) for name in COMMANDS if name not in _ELSEWHERE}
    return {name: form for name, form in found.items() if form is not None}


def form_of(name: str) -> Form | None:
    """The form of a command; None where a required parameter cannot be bound to a run."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    fields: list[Field] = []
    output = ""
    formats: tuple[str, ...] = ()
    for p in command.params:
        if isinstance(p.type, OutputFolder):
            output, formats = p.opts[0], ()
        elif isinstance(p.type, OutputFile):
            output, formats = (output, formats) if output else (p.opts[0], p.type.endings)
        elif p.name not in _PRINTED and not getattr(p, "hidden", False):
            made = _field(p)
            if made is not None:
                fields.append(made)
            elif p.required or isinstance(p, click.Argument):
                return None
    if len(formats) > 1:
        fields.append(
            Field(FORMAT, "", "format", "Of the file that is written.", Kind.CHOICE, default=formats[0], choices=formats)
        )
    parts = inspect.cleandoc(command.help or "").split("\n\n")
    about = tuple(" ".join(part.split()) for part in parts)
    return Form(name, COMMANDS[name], about, tuple(fields), output, formats)


_KINDS: tuple[tuple[type[click.ParamType], Kind], ...] = (
    (ModelFile, Kind.MODEL), (InputFile, Kind.RECORDING), (NamedSource, Kind.SOURCE), (InputPattern, Kind.TEXT),
    (click.Choice, Kind.CHOICE),
    (click.types.BoolParamType, Kind.FLAG), (click.types.IntParamType, Kind.WHOLE), (click.types.FloatParamType, Kind.NUMBER),
    (click.types.StringParamType, Kind.TEXT),
)  # fmt: skip


def _field(p: click.Parameter) -> Field | None:
    """A parameter as a field; None for a type that is not known."""
    kind = next((kind for cls, kind in _KINDS if isinstance(p.type, cls)), None)
    if kind is None or p.name is None:
        return None
    endings = getattr(p.type, "endings", ())
    option = "" if isinstance(p, click.Argument) else max(p.opts, key=len)
    default = p.default if isinstance(p.default, bool | int | float | str) and p.default != "" else None
    return Field(
        p.name, option, (option.lstrip("-") or p.name).replace("-", " ").replace("_", " "), getattr(p, "help", "") or "",
        Kind.FILE if endings else kind, p.required, p.multiple if isinstance(p, click.Option) else p.nargs == -1,
        PATTERN if isinstance(p.type, InputPattern) else default,
        tuple(map(str, p.type.choices)) if isinstance(p.type, click.Choice) else (), getattr(p.type, "min", None),
        getattr(p.type, "max", None), endings, getattr(p.type, "usual", ""), getattr(p.type, "models", False),
    )  # fmt: skip
