"""What a recording is read from: a file, or a folder (LeRobot data set, rosbag2, SAGE), of which ``FOLDER#3`` is one episode.

Of a MAT file with several experiments ``FILE.mat#2`` is the second.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from mjsim.errors import InputError, nearest
from mjsim.readers.lerobot import INFO, is_lerobot
from mjsim.readers.sage import CONTROL, JOINTS, STATE, is_sage

__all__ = ["digest", "files_of", "is_source", "need_source", "part_of", "suffix_of"]

KINDS = "a recording (.csv, .mat, .npz, .parquet, .mcap, .bag, .db3, or the folder of a LeRobot data set, rosbag2 or SAGE)"


def part_of(path: Path) -> tuple[Path, int | None]:
    """Folder and episode of ``FOLDER#3``, file and experiment of ``FILE.mat#2``; any other path as it is."""
    base, mark, number = path.name.rpartition("#")
    if mark and number.isdigit() and not path.exists():
        return path.with_name(base), int(number)
    return path, None


def is_source(path: Path) -> bool:
    """Whether there is a file, or a folder of a form that is known."""
    return path.is_file() or _is_experiment(path) or suffix_of(path) in ("lerobot", "rosbag2", "sage")


def _is_experiment(path: Path) -> bool:
    """Whether a path is one experiment of a MAT file."""
    base, number = part_of(path)
    return number is not None and base.suffix.lower() == ".mat" and base.is_file()


def suffix_of(path: Path) -> str:
    """What says how a source is read: the ending of a file in lower case, or the form of a folder, or empty."""
    base, _ = part_of(path)
    if _is_experiment(path):
        return ".mat"
    if not base.is_dir():
        return path.suffix.lower()
    if is_lerobot(base):
        return "lerobot"
    if (base / "metadata.yaml").is_file():
        return "rosbag2"
    return "sage" if is_sage(base) else ""


def need_source(path: Path) -> None:
    """Raise InputError where there is nothing to read."""
    if is_source(path):
        return
    if part_of(path)[0].is_dir():
        raise InputError(path, "a folder of no known form", KINDS, "name a file in it")
    base = part_of(path)[0]
    beside = [p.name for p in base.parent.iterdir() if is_source(p)] if base.parent.is_dir() else []
    raise InputError(path, "no such file", KINDS, nearest(base.name, beside, "check the path"))


def files_of(path: Path) -> list[Path]:
    """The files that a source is read from."""
    base, _ = part_of(path)
    if not base.is_dir():
        return [base if _is_experiment(path) else path]
    form = suffix_of(path)
    if form == "sage":
        return [p for p in (base / name for name in (JOINTS, STATE, CONTROL)) if p.is_file()]
    if form == "rosbag2":
        return sorted(p for p in base.iterdir() if p.suffix in (".db3", ".mcap"))
    return [base / INFO, *sorted((base / "data").rglob("*.parquet"))]


def digest(path: Path) -> str:
    """SHA-256 of a source: of its bytes; of several files, or of a part of one, of their hashes and the number of the part."""
    files = files_of(path)
    if files == [path]:
        return _of_file(path)
    whole = hashlib.sha256(f"{part_of(path)[1]}".encode())
    for file in files:
        whole.update(_of_file(file).encode())
    return whole.hexdigest()


def _of_file(path: Path) -> str:
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
