"""Runs on disk: a folder each, with what was uploaded, the settings and what the commands wrote.

FOLDER/<id>/run.json       name and settings
FOLDER/<id>/model/         uploaded MJCF and its meshes
FOLDER/<id>/recordings/    uploaded recordings and their bindings
FOLDER/<id>/files/         uploaded scenarios and baselines
FOLDER/<id>/out/COMMAND/   what a command writes
FOLDER/<id>/jobs/          how each command ended, and what it printed; see `simgap.app.record`
"""

from __future__ import annotations

import json
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
from mjsim.scenario import shipped_scenarios
from simgap.app.forms import LONGEST_TEXT, Field, Form, Kind, forms
from simgap.pipeline import STATE

__all__ = [
    "BINDING", "FILES", "HELD_OUT", "KINDS", "MOST_UPLOAD", "RECORDINGS", "MissingError", "Run", "Runs", "Settings", "form_for",
    "read_json", "safe_name", "write_json",
]  # fmt: skip

BINDING = ".toml"
MESHES = (".stl", ".obj", ".msh", ".png", ".skn", ".hf", ".bin")
KINDS = {
    "model": (".xml", *MESHES, BINDING),
    "files": (BINDING, ".json"),
    "recordings": (*(ending for ending in READERS if ending.startswith(".")), BINDING),
}
"""Folder of a run -> endings of files that may be uploaded into it."""
OUT = "out"
RECORDINGS, HELD_OUT = "recordings", "held_out"  # parameters that step 2 of a run fills in
FILES = (Kind.MODEL, Kind.RECORDING, Kind.FILE, Kind.SOURCE)
HIDDEN = (STATE,)  # files in the folder of a command that are no results
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
    """What a run is asked for.

    ``model``: a shipped name, or a file of the run; ``held_out``: names of recordings kept for validation; ``values``: command ->
    field -> value, of the fields that were filled in.
    """

    model: str = ""
    held_out: tuple[str, ...] = ()
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def changed(self, new: Mapping[str, Any]) -> Settings:
        """These settings with the given ones in their place; values of fields are added to those of their command.

        Raises InputError for an unknown name, type or value.
        """
        known = ("model", "held_out", "values")
        for name in new:
            if name not in known:
                raise InputError(
                    f"setting {name[:LONGEST_NAME]!r}", "unknown", f"one of: {', '.join(known)}", nearest(name, known)
                )
        model, held_out, values = new.get("model", self.model), new.get("held_out", self.held_out), dict(self.values)
        if not isinstance(model, str) or len(model) > LONGEST_TEXT or not model.isprintable():
            raise InputError("setting 'model'", "no short text", f"at most {LONGEST_TEXT} printable characters")
        if not isinstance(held_out, list | tuple) or not all(isinstance(v, str) for v in held_out) or len(held_out) > MOST_FILES:
            raise InputError("setting 'held_out'", "no list of names", "names of recordings")
        given = new.get("values", {})
        if not isinstance(given, Mapping):
            raise InputError("setting 'values'", f"{given!r:.40}", "an object: command, then field, then value")
        for command, fields in given.items():
            if not isinstance(fields, Mapping):
                raise InputError(f"setting {command!r:.80}", f"{fields!r:.40}", "an object of fields")
            there = {**values.get(command, {}), **form_for(command).checked(fields)}
            values[command] = {name: value for name, value in there.items() if name not in fields or not _empty(fields[name])}
        return Settings(model.strip(), tuple(safe_name(v) for v in held_out), values)


def _empty(value: Any) -> bool:
    """Whether a value clears a field."""
    return value is None or value is False or value == ""


def form_for(command: str) -> Form:
    """The form of a command. Raises InputError for one that has none."""
    found = forms().get(command)
    if found is None:
        raise InputError(f"command {command!r:.80}", "unknown", f"one of: {', '.join(forms())}", nearest(command, forms()))
    return found


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

    def out(self, command: str) -> Path:
        """Where a command writes."""
        return self.folder / OUT / command

    def files(self, kind: str) -> list[str]:
        """Names of the files that were uploaded into a folder of `KINDS`, sorted."""
        folder = self.folder / kind
        return sorted(p.name for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")) if folder.is_dir() else []

    @property
    def recordings(self) -> list[str]:
        """Names of the recordings, without their bindings."""
        return [n for n in self.files("recordings") if not n.lower().endswith(BINDING)]

    def written(self, command: str) -> list[str]:
        """Files that a command wrote, relative to its folder: pages first, then pictures and films, then others by name."""
        top = self.out(command)
        paths = (p for p in top.rglob("*") if p.is_file() and not p.is_symlink()) if top.is_dir() else ()
        names = [p.relative_to(top).as_posix() for p in paths]
        shown = (n for n in names if not any(part.startswith(".") for part in n.split("/")) and n not in HIDDEN)
        return sorted(shown, key=lambda n: (n.count("/"), _rank(n), n))[:MOST_FILES]

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
        write_json(self.folder / "run.json", {"name": self.name, "settings": asdict(self.settings)})

    def with_settings(self, new: Mapping[str, Any]) -> Run:
        """Save changed settings. Raises InputError for a model that is not there."""
        changed = replace(self, settings=self.settings.changed(new))
        if changed.settings.model and changed.settings.model not in changed.models():
            known = changed.models()
            raise InputError(f"model {changed.settings.model!r:.80}", "not there", f"one of: {', '.join(known)}",
                             nearest(changed.settings.model, known))  # fmt: skip
        changed.save()
        return changed

    def models(self) -> list[str]:
        """Models that can be chosen: uploaded, written by a command, shipped."""
        return [*self._uploaded("model", (".xml",)), *self._results((".xml",)), *shipped_models()]

    def candidates(self, f: Field) -> list[str]:
        """What a field of files may hold: paths relative to the run's folder, and shipped names."""
        if f.kind is Kind.MODEL:
            return self.models()
        if f.kind is Kind.SOURCE:
            return [*self._uploaded("files", (BINDING,)), *(self.models() if f.models else ()), *shipped_scenarios()]
        if f.kind is Kind.FILE:
            return [*self._uploaded("files", f.endings), *self._results(f.endings)]
        readable = tuple(e for e in KINDS["recordings"] if e != BINDING)
        return [*(f"recordings/{n}" for n in self.recordings), *self._results(readable)]

    def _uploaded(self, kind: str, endings: tuple[str, ...]) -> list[str]:
        return [f"{kind}/{n}" for n in self.files(kind) if n.lower().endswith(endings)]

    def _results(self, endings: tuple[str, ...]) -> list[str]:
        return [f"{OUT}/{c}/{n}" for c in forms() for n in self.written(c) if n.lower().endswith(endings)]

    def automatic(self, form: Form, f: Field) -> list[str]:
        """What a field of files holds while nothing is chosen: the run's model, its recordings, the newest file that fits.

        Of a command that keeps recordings for validation, ``recordings`` are the others.
        """
        if f.name in (HELD_OUT, RECORDINGS):
            split = any(other.name == HELD_OUT for other in form.fields)
            held = [n for n in self.recordings if n in self.settings.held_out]
            rest = [n for n in self.recordings if not (split and n in held)]
            return [f"recordings/{n}" for n in (held if f.name == HELD_OUT else rest)]
        if not f.required:
            return []
        if f.kind in (Kind.MODEL, Kind.SOURCE):
            return [self.settings.model] if self.settings.model else []
        fitting = (name for name in self.candidates(f) if not f.usual or name.rpartition("/")[2] == f.usual)
        return list(fitting)[:1]

    def words(self, command: str) -> list[str]:
        """The words of the command line after ``simgap``, relative to the run's folder. Raises InputError for what is missing."""
        form = form_for(command)
        values = self.settings.values.get(command, {})
        files: dict[str, list[str]] = {}
        for f in form.fields:
            if f.kind in FILES:
                files[f.name] = self._chosen(form, f, values.get(f.name))
        lacking = [f for f in form.fields if f.required and not files.get(f.name, values.get(f.name, f.default))]
        if lacking:
            self._lacks(min(lacking, key=lambda f: f.kind not in (Kind.MODEL, Kind.SOURCE)))
        return form.words({f.name: f.default for f in form.fields if f.required} | dict(values), files, f"{OUT}/{command}")

    def _chosen(self, form: Form, f: Field, value: Any) -> list[str]:
        if value is None or f.name in (RECORDINGS, HELD_OUT):
            return self.automatic(form, f)
        known = self.candidates(f)
        if value not in known:
            raise InputError(
                f.label, f"{value!r:.80} is not there", f"one of: {', '.join(known) or 'none yet'}", nearest(value, known)
            )
        return [value]

    def _lacks(self, f: Field) -> None:
        if f.kind in (Kind.MODEL, Kind.SOURCE):
            raise InputError(f.label, "none was chosen", "a shipped model or an uploaded MJCF file", "choose one in step 1")
        if f.kind is Kind.RECORDING and self.recordings:
            raise InputError(f.label, "all of them are held out", "at least one to identify from", "clear one mark")
        if f.kind is Kind.RECORDING:
            raise InputError(f.label, "there are none", "at least one", "upload one in step 2")
        raise InputError(f.label, "nothing is given", f.help or "a value", "fill it in")


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
        kept = read_json(path / "run.json")
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


def _rank(name: str) -> int:
    """Pages before pictures before the rest."""
    return next((i for i, endings in enumerate(((".html",), (".mp4", ".gif", ".png", ".svg"))) if name.endswith(endings)), 2)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write an object in one move."""
    handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".part")
    with os.fdopen(handle, "w", encoding="utf-8") as out:
        json.dump(content, out, indent=1)
    os.replace(scratch, path)


def read_json(path: Path) -> dict[str, Any]:
    """An object from a JSON file; empty where there is none that can be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
