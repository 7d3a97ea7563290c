"""The two ways in which simgap ends other than well: bad input (exit 2) and a check that was missed (exit 1)."""

from __future__ import annotations

import contextlib
import difflib
import os
import re
from collections.abc import Iterable, Iterator

__all__ = ["CheckError", "InputError", "nearest", "nearest_file", "writing"]

_WORD = re.compile(r"[a-z0-9]+")


def nearest(name: str, choices: Iterable[str], advice: str = "name one of them") -> str:
    """Advice for an unknown name: ``did you mean 'x'?`` where one choice begins with it or resembles it, else ``advice``.

    Resemblance is difflib's ratio of matching characters, at least 0.6 (its default), of the whole name; else at least 0.8 of
    a word of one choice alone (``frction`` and ``coulomb_friction``), without regard to upper and lower case.
    """
    known = list(choices)
    begun = [c for c in known if name and c.startswith(name)]
    close = begun if len(begun) == 1 else difflib.get_close_matches(name, known, 1)
    if not close:
        lower = name.lower()
        alike = [c for c in known if difflib.get_close_matches(lower, {c.lower(), *_WORD.findall(c.lower())}, 1, 0.8)]
        close = alike if len(alike) == 1 else difflib.get_close_matches(lower, alike, 1, 0.0)
    return f"did you mean {close[0]!r}?" if close else advice


def nearest_file(path: str | os.PathLike[str], *endings: str, advice: str = "check the path") -> str:
    """`nearest` among the files of these endings in the folder of a path that is not there."""
    folder, name = os.path.split(os.fspath(path))
    try:
        there = [n for n in os.listdir(folder or ".") if n.endswith(endings)]
    except OSError:
        there = []
    return nearest(name, there, advice)


@contextlib.contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Name the file in an OSError that names none, as that of a write to a full disk; the error goes on."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = os.fspath(path)
        raise


class InputError(ValueError):
    """Input that cannot be used.

    The message is one line: the file, the row or key, what was found, what was expected and what to do.

    >>> import simgap
    >>> try:
    ...     simgap.load({"time_s": [0.0, 0.1], "torque_Nm": [0.0, 1.0]})
    ... except simgap.InputError as error:
    ...     print(error)
    memory: neither velocity nor angle; expected one of velocity_rad_s, angle_rad; add a column or bind one by binding
    """

    def __init__(self, where: object, found: str, expected: str = "", todo: str = "") -> None:
        self._told = (str(where), found, expected, todo)
        parts = [f"{where}: {found}"]
        if expected:
            parts.append(f"expected {expected}")
        if todo:
            parts.append(todo)
        super().__init__("; ".join(parts).replace("\n", " "))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """How it comes from a process that others wait for: it would end there, and all of them."""
        return type(self), self._told


class CheckError(RuntimeError):
    """A check that the user asked for was made and missed (exit 1)."""
