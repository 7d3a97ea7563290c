"""Runs on disk: a folder each, with what was uploaded, the settings and what the commands wrote.

FOLDER/<id>/run.json       name and settings
FOLDER/<id>/model/         uploaded MJCF and its meshes
FOLDER/<id>/recordings/    uploaded recordings and their bindings
FOLDER/<id>/out/           what simgap check and simgap diagnose write
FOLDER/<id>/progress.txt   the lines of the last command; ended.json: how it ended
"""

from __future__ import annotations

import json
import math
import os
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from mjsim.errors import InputError, nearest
from mjsim.models import shipped_models
from mjsim.readers import MOST_BYTES, READERS

__all__ = ["ANSWERS", "BINDING", "KINDS", "MOST_UPLOAD", "MissingError", "Run", "Runs", "Settings", "safe_name"]

BINDING = ".toml"
MESHES = (".stl", ".obj", ".msh", ".png", ".skn", ".hf", ".bin")
KINDS = {
    "model": (".xml", *MESHES, BINDING),
    "recordings": (*(ending for ending in READERS if ending.startswith(".")), BINDING),
}
"""Folder of a run -> endings of files that may be uploaded into it."""
ANSWERS = {
    "check": ("check.html", "check.json"),
    "diagnose": ("report.html", "summary.md", "corrected.xml", "mapped.xml", "nominal.xml", "diagnosis.json"),
}
"""Command -> files that it writes and that are served."""
MOST_UPLOAD = min(MOST_BYTES, 512 * 2**20)  # bytes of one file; readers take more from a disk
MOST_FILES = 200  # in one folder of a run: an MJCF of a humanoid has about 100 meshes
LONGEST_NAME = 120  # characters of a file or run name; file systems allow 255 bytes
_ID = re.compile(r"\d{8}-\d{6}-[0-9a-f]{6}")


class MissingError(LookupError):
    """There is no such run or file."""


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


@dataclass(frozen=True)
class Settings:
    """What a diagnosis is asked for; as the options of ``simgap diagnose``.

    ``model``: a shipped name, or ``model/FILE``; ``held_out``: names of recordings kept for validation.
    """

    model: str = ""
    held_out: tuple[str, ...] = ()
    effects: str = ""
    joints: str = ""
    judge: str = ""
    effort: float = 1.0
    budget: float = 0.0
    seed: int = 0
    accept_log: bool = False
    film: bool = False
    markdown: bool = False

    def changed(self, new: Mapping[str, Any]) -> Settings:
        """These settings with the given ones in their place. Raises InputError for an unknown name, type or value."""
        known = asdict(self)
        for name, value in new.items():
            if name not in known:
                raise InputError(
                    f"setting {name[:LONGEST_NAME]!r}", "unknown", f"one of: {', '.join(known)}", nearest(name, known)
                )
            known[name] = _typed(name, value, known[name])
        return Settings(**known)


def _typed(name: str, value: Any, default: Any) -> Any:
    """The value as the type of the present one."""
    where = f"setting {name!r}"
    if isinstance(default, tuple):
        if not isinstance(value, list | tuple) or not all(isinstance(v, str) for v in value) or len(value) > MOST_FILES:
            raise InputError(where, "no list of names", "names of recordings")
        return tuple(safe_name(v) for v in value)
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise InputError(where, f"{value!r:.40}", "true or false")
        return value
    if isinstance(default, str):
        if not isinstance(value, str) or len(value) > 1000 or not value.isprintable():
            raise InputError(where, "no short text", "at most 1000 printable characters")
        if name == "judge" and value not in ("", "motion", "force"):
            raise InputError(where, f"{value!r:.40}", "motion, force or nothing")
        return value.strip()
    whole = isinstance(default, int)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or not 0 <= value < 2**31:
        raise InputError(where, f"{value!r:.40}", "a number of at least 0, below 2^31")
    if whole and value != int(value):
        raise InputError(where, f"{value!r:.40}", "a whole number")
    return int(value) if whole else float(value)


@dataclass(frozen=True)
class Run:
    """One run: its folder, name, and settings."""

    folder: Path
    name: str
    settings: Settings = field(default_factory=Settings)

    @property
    def id(self) -> str:
        """Name of the folder."""
        return self.folder.name

    @property
    def out(self) -> Path:
        """Where the commands write."""
        return self.folder / "out"

    def files(self, kind: str) -> list[str]:
        """Names of the files that were uploaded into a folder of `KINDS`, sorted."""
        folder = self.folder / kind
        return sorted(p.name for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")) if folder.is_dir() else []

    @property
    def recordings(self) -> list[str]:
        """Names of the recordings, without their bindings."""
        return [n for n in self.files("recordings") if not n.lower().endswith(BINDING)]

    def place(self, kind: str, name: str) -> Path:
        """Where an uploaded file goes. Raises InputError for an ending that cannot be read, and for too many files."""
        if kind not in KINDS:
            raise MissingError(kind)
        safe = safe_name(name)
        if Path(safe).suffix.lower() not in KINDS[kind]:
            raise InputError(safe, "a file of a kind that is not read here", f"one of {', '.join(KINDS[kind])}", "convert it")
        there = self.files(kind)
        if safe not in there and len(there) >= MOST_FILES:
            raise InputError(kind, f"{len(there)} files are there", f"at most {MOST_FILES}", "delete some, or start another run")
        return self.folder / kind / safe

    def save(self) -> None:
        """Write ``run.json`` in one move."""
        _write(self.folder / "run.json", {"name": self.name, "settings": asdict(self.settings)})

    def with_settings(self, new: Mapping[str, Any]) -> Run:
        """Save changed settings; answers that hold for another model or split of recordings are removed."""
        settings = self.settings.changed(new)
        if settings.model:
            self._need_model(settings.model)
        changed = replace(self, settings=settings)
        changed.save()
        if settings.model != self.settings.model:
            self.forget("check")
        if (settings.model, settings.held_out) != (self.settings.model, self.settings.held_out):
            self.forget("diagnose")
        return changed

    def _need_model(self, model: str) -> None:
        own = [f"model/{n}" for n in self.files("model") if n.lower().endswith(".xml")]
        known = [*own, *shipped_models()]
        if model not in known:
            raise InputError(f"model {model!r:.80}", "not there", f"one of: {', '.join(known)}", nearest(model, known))

    def forget(self, command: str) -> None:
        """Remove the answers of a command, and how it ended."""
        for name in ANSWERS[command]:
            (self.out / name).unlink(missing_ok=True)
        if self.ended().get("command") == command:
            (self.folder / "ended.json").unlink(missing_ok=True)

    def ended(self) -> dict[str, Any]:
        """How the last command ended: command, code, error; empty where none has; a command without a code was broken off."""
        return _read(self.folder / "ended.json")

    def begin(self, command: str) -> None:
        """Note that a command runs, and remove its earlier answers."""
        self.forget(command)
        self.out.mkdir(parents=True, exist_ok=True)
        _write(self.folder / "ended.json", {"command": command, "code": None, "error": ""})

    def end(self, command: str, code: int, error: str, lines: list[str]) -> None:
        """Note how it ended."""
        (self.folder / "progress.txt").write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        _write(self.folder / "ended.json", {"command": command, "code": code, "error": error})

    def words(self, command: str) -> list[str]:
        """The words of the command line after ``simgap``, relative to the run's folder. Raises InputError for what is missing."""
        s = self.settings
        if not s.model:
            raise InputError("model", "none was chosen", "a shipped model or an uploaded MJCF file", "choose one in step 1")
        self._need_model(s.model)
        if not self.recordings:
            raise InputError("recordings", "there are none", "at least one", "upload one in step 2")
        common = [f"--model={s.model}", "--out=out"]
        if command == "check":
            return ["check", *common, *(f"recordings/{n}" for n in self.recordings)]
        held_out = [n for n in self.recordings if n in s.held_out]
        used = [n for n in self.recordings if n not in held_out]
        if not used:
            raise InputError("recordings", "all of them are held out", "at least one to identify from", "clear one mark")
        options = [f"--effects={s.effects}", f"--effort={s.effort}", f"--budget={s.budget}", f"--seed={s.seed}"]
        options += [f"--held-out=recordings/{n}" for n in held_out]
        options += [f"--joint={j.strip()}" for j in s.joints.split(",") if j.strip()]
        options += [f"--judge={s.judge}"] * bool(s.judge) + ["--accept-log"] * s.accept_log
        options += ["--film"] * s.film + ["--markdown"] * s.markdown
        return ["diagnose", *common, *options, *(f"recordings/{n}" for n in used)]


class Runs:
    """All runs in a folder. Raises InputError where it cannot be made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError("--folder", f"{str(folder)!r} cannot be made ({error.strerror})", "a writable folder") from None

    def all(self) -> list[Run]:
        """The newest first."""
        names = sorted((p.name for p in self.folder.iterdir() if _ID.fullmatch(p.name)), reverse=True)
        return [self.get(n) for n in names if (self.folder / n / "run.json").is_file()]

    def get(self, run_id: str) -> Run:
        """A run by its id. Raises MissingError where there is none; nothing but an id reaches the file system."""
        path = self.folder / run_id
        if not _ID.fullmatch(run_id) or not (path / "run.json").is_file():
            raise MissingError(run_id)
        kept = _read(path / "run.json")
        try:
            settings = Settings().changed(kept.get("settings", {}))
        except InputError:  # of another version, or edited: the run's files and answers can still be seen
            settings = Settings()
        return Run(path, str(kept.get("name", run_id)), settings)

    def new(self, name: str = "", like: Run | None = None) -> Run:
        """A new run, with a copy of another's model, recordings and settings where one is given."""
        run_id = f"{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(3)}"
        shown = "".join(c for c in name if c.isprintable())[:LONGEST_NAME].strip()
        run = Run(self.folder / run_id, shown or f"Run {run_id[:-7]}", like.settings if like else Settings())
        for kind in KINDS:
            (run.folder / kind).mkdir(parents=True)
            if like is not None:
                for file in like.files(kind):
                    shutil.copyfile(like.folder / kind / file, run.folder / kind / file)
        run.save()
        return run

    def delete(self, run: Run) -> None:
        """Remove a run with all its files."""
        shutil.rmtree(run.folder)


def _write(path: Path, content: Mapping[str, Any]) -> None:
    handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".part")
    with os.fdopen(handle, "w", encoding="utf-8") as out:
        json.dump(content, out, indent=1)
    os.replace(scratch, path)


def _read(path: Path) -> dict[str, Any]:
    """An object from a JSON file; empty where there is none that can be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
