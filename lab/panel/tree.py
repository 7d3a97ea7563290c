"""The code that is run: a checkout, or a commit in a git worktree that is removed at the end."""

from __future__ import annotations

import hashlib
import platform
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from mjsim.errors import InputError

__all__ = ["Tree", "at_commit", "checkout", "here"]

PACKAGES = ("mjsim", "ident", "diagnose", "simgap")  # what an answer follows from
LIBRARIES = ("numpy", "scipy", "numba", "mujoco")


@dataclass(frozen=True)
class Tree:
    """A checkout. ``commit``: its short hash, with ``+`` where files differ from it; ``stamp``: SHA-256 of code and libraries."""

    folder: Path
    commit: str
    stamp: str


def here() -> Path:
    """The checkout that this file is in."""
    return Path(__file__).resolve().parents[2]


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no reason given"]
        raise InputError(f"git {words[0]}", lines[-1], "a git checkout that holds the commit")
    return done.stdout.strip()


def _stamp(folder: Path) -> str:
    """Hash of the code of a diagnosis, the page aside, and of the versions of its libraries."""
    digest = hashlib.sha256(platform.python_version().encode())
    for name in PACKAGES:
        for path in sorted(p for p in (folder / name).rglob("*.py") if "report" not in p.parts):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    for name in LIBRARIES:
        try:
            digest.update(f"{name} {version(name)}".encode())
        except PackageNotFoundError:
            digest.update(f"{name} none".encode())
    return digest.hexdigest()


def checkout(folder: Path) -> Tree:
    """The code in a folder as it stands. Raises InputError where it is no checkout of this project."""
    folder = folder.resolve()
    if not (folder / "simgap" / "pipeline.py").is_file():
        raise InputError(folder, "no simgap/pipeline.py there", "a checkout of this project", "correct --tree")
    commit = _git(folder, "rev-parse", "--short=9", "HEAD")
    changed = _git(folder, "status", "--porcelain", "--", *PACKAGES)
    return Tree(folder, commit + ("+" if changed else ""), _stamp(folder))


@contextmanager
def at_commit(revision: str, where: Path) -> Iterator[Tree]:
    """A worktree of a commit under the folder ``where``, removed at the end. Raises InputError where there is none."""
    full = _git(here(), "rev-parse", "--verify", f"{revision}^{{commit}}")
    folder = (where / full[:12]).resolve()
    if folder.exists():  # of a run that was broken off
        _remove(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    _git(here(), "worktree", "add", "--detach", str(folder), full)
    try:
        yield checkout(folder)
    finally:
        _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a worktree and what was compiled in it."""
    subprocess.run(["git", "-C", str(here()), "worktree", "remove", "--force", str(folder)], capture_output=True, check=False)
    shutil.rmtree(folder, ignore_errors=True)
    _git(here(), "worktree", "prune")
