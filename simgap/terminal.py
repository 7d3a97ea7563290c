"""Text that is safe on a terminal: control characters of file and column names are escaped, one message is one short line."""

from __future__ import annotations

import errno
import os

__all__ = ["PROGRESS", "file_error", "lines_wanted", "one_line", "printable", "rich_text"]

LONGEST = 2000  # characters of an error line: 25 lines of a terminal of 80 columns


PROGRESS = "SIMGAP_PROGRESS"
"""Environment variable: ``lines`` asks for progress as lines on standard error, also where that is no terminal."""


def lines_wanted() -> bool:
    """Whether progress is asked for as lines."""
    return os.environ.get(PROGRESS) == "lines"


def printable(text: str) -> str:
    r"""The text with control and format characters escaped (``\x1b``, ``\u202e``); line breaks and tabs stay."""
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode("ascii") for c in text)


def rich_text(text: str) -> str:
    """`printable` text whose square brackets rich does not take for markup."""
    from rich.markup import escape

    return escape(printable(text))


def one_line(text: str) -> str:
    """`printable` text in one line of at most `LONGEST` characters; the middle of a longer one is left out."""
    line = printable(" ".join(text.split()))
    half = LONGEST // 2 - 3
    return line if len(line) <= LONGEST else f"{line[:half]} ... {line[-half:]}"


def file_error(error: OSError) -> str:
    """One line for a file that cannot be read or written: its name, what the system says, what to do."""
    advice = {
        errno.ENOSPC: "free some space, or choose another --out",
        errno.EDQUOT: "free some space, or choose another --out",
    }.get(error.errno or 0, "check the path and its permissions, or choose another --out")
    where = "a file" if error.filename is None else str(error.filename)
    return f"{where}: {error.strerror or error}; {advice}"
