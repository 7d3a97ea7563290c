"""One run at a time for an output folder or file: a second one is refused, since each would replace files of the other."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

__all__ = ["sole", "sole_in_python"]

BUSY = -1


@contextlib.contextmanager
def sole(out: Path, kind: str = "folder") -> Iterator[None]:
    """Hold an output place while the block runs. Raises InputError where another process of this machine holds it.

    ``kind``: "folder" or "file", for the message.

    The lock is one of the operating system on a file in the folder of temporary files: it ends with the process, however that
    ends, and the place need not exist yet. Where no lock can be had (no such folder, another system) the block runs
    without one.
    """
    from mjsim.errors import InputError

    held = None
    with contextlib.suppress(OSError, ImportError):
        held = _held(out)
    if held == BUSY:
        raise InputError(out, f"another run writes to this {kind}", "one run at a time", "wait for it, or choose another place")
    try:
        yield
    finally:
        if held is not None:
            with contextlib.suppress(OSError):
                _place(out).unlink()
            os.close(held)


def sole_in_python(out: Path) -> contextlib.AbstractContextManager[None]:
    """`sole`, for a call from Python; a command holds its folder itself, before it calls."""
    import click

    return sole(out) if click.get_current_context(silent=True) is None else contextlib.nullcontext()


def _place(out: Path) -> Path:
    """The file of the lock of a folder."""
    name = hashlib.sha256(os.fsencode(out.resolve())).hexdigest()[:24]
    return Path(tempfile.gettempdir()) / f"simgap-{name}.lock"


def _held(out: Path) -> int:
    """A descriptor that holds the lock, `BUSY` where another process does."""
    import fcntl

    place = _place(out)
    while True:
        descriptor = os.open(place, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return BUSY
        with contextlib.suppress(FileNotFoundError):  # the holder before removed the file that was opened here
            if os.path.samestat(os.fstat(descriptor), place.stat()):
                return descriptor
        os.close(descriptor)
