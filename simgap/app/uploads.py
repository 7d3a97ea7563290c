"""What may be uploaded: names, kinds and sizes of files, folders and ZIP archives; no path leads out of its folder.

A name of one recording is made safe. Names in folders, in archives and of a model's files are kept as they are or refused,
because files name each other. Nothing that is uploaded is imported or run.
"""

from __future__ import annotations

import os
import posixpath
import re
import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mjsim.errors import InputError
from mjsim.readers import MOST_BYTES, READERS
from mjsim.readers.lerobot import episodes
from mjsim.readers.source import suffix_of

__all__ = [
    "ARCHIVE", "BESIDE", "BINDING", "KINDS", "LONGEST_NAME", "MOST_FILES", "MOST_UNPACKED", "MOST_UPLOAD", "SIMPLE", "Unpacked",
    "accepted", "files_below", "main_model", "recordings_in", "safe_name", "safe_path", "unpack",
]  # fmt: skip

ARCHIVE = ".zip"
BINDING = ".toml"
MESHES = (".stl", ".obj", ".mtl", ".msh", ".png", ".skn", ".hf", ".bin")
SIMPLE = tuple(ending for ending in READERS if ending.startswith("."))
"""Endings of recordings that are one file."""
BESIDE = (".json", ".yaml", ".txt")  # of the files that make a folder a LeRobot data set, a rosbag2 or a SAGE recording
KINDS = {
    "model": (".xml", *MESHES, BINDING),
    "files": (BINDING, ".json"),
    "recordings": (*SIMPLE, BINDING),
}
"""Folder of a run -> endings of files that may be uploaded into it."""
MOST_UPLOAD = min(MOST_BYTES, 512 * 2**20)  # bytes of one file or archive; readers take more from a disk
MOST_UNPACKED = 4 * MOST_UPLOAD  # bytes of the files of an archive; measured as they are unpacked
MOST_FILES = 1000  # of one kind in a run: a humanoid has about 100 meshes, a LeRobot data set a file an episode
MOST_EPISODES = 20  # of a LeRobot data set that are offered
DEEPEST = 10  # folders within one another
LONGEST_NAME = 120  # characters of the name of a file, folder or run; file systems allow 255 bytes
PART = 2**20  # bytes that are unpacked at a time
_FORBIDDEN = re.compile(r'[\\:*?"<>|#]')  # by Windows, or with a meaning in the name of a recording
_INCLUDE = re.compile(rb"""<include\b[^>]*?\bfile\s*=\s*["']([^"']+)["']""")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


def safe_name(name: str) -> str:
    """A base name of letters, digits, ``._-``, that neither begins with a dot or hyphen nor leads out of its folder.

    Folders are cut off, other characters become ``_``. Raises InputError where nothing is left.
    """
    base = name.replace("\\", "/").rpartition("/")[2]
    kept = re.sub(r"[^A-Za-z0-9._-]", "_", base).lstrip(".-")
    stem, dot, ending = kept.rpartition(".")
    cut = f"{stem[: LONGEST_NAME - len(ending) - 1]}{dot}{ending}" if dot else kept[:LONGEST_NAME]
    if not cut or len(cut) > LONGEST_NAME:
        raise InputError("file name", f"{name[:LONGEST_NAME]!r} is no name of a file", "letters and digits", "rename it")
    return cut


def safe_path(path: str) -> str:
    """The path of a file in a folder, unchanged. Raises InputError for one that is absolute, leads out, or has an odd name."""
    parts = path.split("/")
    if len(parts) > DEEPEST + 1:
        raise InputError("path", f"{path[:LONGEST_NAME]!r} is {len(parts)} deep", f"at most {DEEPEST} folders", "flatten it")
    for part in parts:
        good = part.isprintable() and part[:1] not in (".", "-", " ", "") and part[-1:] not in (".", " ")
        if not good or len(part) > LONGEST_NAME or _FORBIDDEN.search(part):
            raise InputError(
                "path", f"{part[:LONGEST_NAME]!r} in {path[:LONGEST_NAME]!r} is no name of a file or folder here",
                f'at most {LONGEST_NAME} characters, none of \\ : * ? " < > | #, no dot, hyphen or space first', "rename it",
            )  # fmt: skip
    return path


def accepted(kind: str, path: str) -> bool:
    """Whether a file may be uploaded into a folder of `KINDS`: by its ending, and whether it lies in a folder of its own."""
    endings = KINDS[kind] + (BESIDE if kind == "recordings" and "/" in path else ())
    return posixpath.splitext(path)[1].lower() in endings


def files_below(folder: Path) -> list[str]:
    """The files of a folder and of those below it, as paths relative to it, sorted; hidden ones and links are left out."""
    if not folder.is_dir():
        return []
    paths = (p for p in folder.rglob("*") if p.is_file() and not p.is_symlink())
    names = (p.relative_to(folder).as_posix() for p in paths)
    return sorted(n for n in names if not _hidden(n.split("/")))


def _hidden(parts: Iterable[str]) -> bool:
    return any(part.startswith(".") or part == "__MACOSX" for part in parts)


def recordings_in(folder: Path) -> list[str]:
    """The recordings in a folder and those below it, as paths relative to it, sorted: files, or folders of a known form.

    ``FOLDER#3`` is an episode of a data set that holds several.
    """
    found = []
    for top, below, files in os.walk(folder):
        below[:] = [name for name in below if not _hidden([name])]
        path = Path(top)
        if path != folder and suffix_of(path) in READERS:
            below.clear()
            found += _episodes(path, path.relative_to(folder).as_posix())
            continue
        names = (n for n in files if n.lower().endswith(SIMPLE) and not _hidden([n]))
        found += [(path / n).relative_to(folder).as_posix() for n in names if not (path / n).is_symlink()]
    return sorted(found, key=_counted)


def _episodes(path: Path, name: str) -> list[str]:
    """A folder as one recording, or its episodes; a damaged one is a recording whose reader says what is wrong."""
    if suffix_of(path) != "lerobot":
        return [name]
    try:
        count = episodes(path)
    except (InputError, OSError, ValueError, TypeError):
        return [name]
    return [name] if count < 2 else [f"{name}#{i}" for i in range(min(count, MOST_EPISODES))]


def _counted(name: str) -> tuple[str, int]:
    """Episode 10 after episode 9."""
    base, _, number = name.rpartition("#")
    return (base, int(number)) if number.isdigit() else (name, -1)


def main_model(folder: Path, names: Sequence[str]) -> str:
    """The one MJCF file that no other of these includes; empty where there are none or several."""
    files = [n for n in names if n.lower().endswith(".xml")]
    included: set[str] = set()
    for name in files:
        text = _COMMENT.sub(b"", (folder / name).read_bytes())
        for found in _INCLUDE.findall(text):
            included.add(posixpath.normpath(posixpath.join(posixpath.dirname(name), found.decode(errors="replace"))))
    left = [n for n in files if n not in included]
    return left[0] if len(left) == 1 else ""


@dataclass(frozen=True)
class Unpacked:
    """The files of an archive that were kept, relative to the folder of their kind, and how many were left out by their kind."""

    names: tuple[str, ...]
    left_out: int


def unpack(archive: Path, name: str, folder: Path, kind: str, room: int) -> Unpacked:
    """Unpack a ZIP file into a folder in ``folder``, in the place of one of the same name.

    name: that of the archive; kind: a key of `KINDS`; room: how many files may be added. The folder has the name of the archive's
    only folder, else of the archive. Raises InputError for what is no ZIP file, holds links, encrypted files or paths that lead
    out, or is too large; then nothing is changed.
    """
    scratch = Path(tempfile.mkdtemp(dir=folder, prefix="."))
    try:
        with zipfile.ZipFile(archive) as packed:
            top, chosen, left_out = _chosen(packed.infolist(), name, kind, room)
            total = 0
            for path, info in chosen.items():
                total = _extract(packed, info, scratch / path, total, name)
        shutil.rmtree(folder / top, ignore_errors=True)
        (scratch / top).replace(folder / top)
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
        ValueError,
        FileExistsError,
        NotADirectoryError,
    ) as error:
        raise InputError(name, f"not a readable ZIP file ({error})", "a ZIP file", "pack it again") from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return Unpacked(tuple(sorted(chosen)), left_out)


def _chosen(infos: Sequence[zipfile.ZipInfo], name: str, kind: str, room: int) -> tuple[str, dict[str, zipfile.ZipInfo], int]:
    """The folder that is made, path -> entry of the files that are kept, and the number of those that are left out."""
    files = {}
    for info in infos:
        parts = info.filename.replace("\\", "/").split("/")
        if info.is_dir() or (_hidden(parts) and ".." not in parts):
            continue
        path = safe_path("/".join(parts))
        if stat.S_ISLNK(info.external_attr >> 16):
            raise InputError(name, f"{path[:LONGEST_NAME]!r} is a link", "files", "pack what it leads to")
        if info.flag_bits & 1:
            raise InputError(name, f"{path[:LONGEST_NAME]!r} is encrypted", "files without a password", "pack it again")
        if path in files:
            raise InputError(name, f"it holds {path[:LONGEST_NAME]!r} twice", "each file once", "pack it again")
        files[path] = info
    tops = {path.partition("/")[0] for path in files}
    alone = len(tops) == 1 and all("/" in path for path in files)
    top = tops.pop() if alone else safe_name(name).removesuffix(ARCHIVE)
    placed = files if alone else {f"{top}/{path}": info for path, info in files.items()}
    kept = {path: info for path, info in placed.items() if accepted(kind, path)}
    if not kept:
        raise InputError(name, "it holds no file that is read here", f"files of {', '.join(KINDS[kind])}", "check the archive")
    if len(kept) > room:
        raise InputError(name, f"it holds {len(kept)} files", f"at most {room} more", "pack fewer, or start another run")
    return top, kept, len(placed) - len(kept)


def _extract(packed: zipfile.ZipFile, info: zipfile.ZipInfo, to: Path, total: int, name: str) -> int:
    """Write one file; the bytes of all so far. What an archive declares of its sizes is not believed."""
    to.parent.mkdir(parents=True, exist_ok=True)
    with packed.open(info) as file, to.open("xb") as out:
        while part := file.read(PART):
            total += len(part)
            if total > MOST_UNPACKED:
                raise InputError(name, "too large when unpacked", f"at most {MOST_UNPACKED >> 20} MiB", "pack fewer files")
            out.write(part)
    return total
