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
from mjsim.robot.scenario import shipped_robot_scenarios
from mjsim.scenario import shipped_scenarios
from simgap.app.forms import LONGEST_TEXT, Field, Form, Kind, forms
from simgap.app.uploads import (
    BINDING,
    KINDS,
    LONGEST_NAME,
    MOST_FILES,
    SIMPLE,
    Unpacked,
    accepted,
    files_below,
    main_model,
    recordings_in,
    safe_name,
    safe_path,
    unpack,
)  # fmt: skip
from simgap.pipeline import STATE

__all__ = ["FILES", "HELD_OUT", "RECORDINGS", "MissingError", "Run", "Runs", "Settings", "form_for", "read_json", "write_json"]

OUT = "out"
RECORDINGS, HELD_OUT = "recordings", "held_out"  # parameters that step 2 of a run fills in
FILES = (Kind.MODEL, Kind.RECORDING, Kind.FILE, Kind.SOURCE)
HIDDEN = (STATE,)  # files in the folder of a command that are no results
_ID = re.compile(r"\d{8}-\d{6}-[0-9a-f]{6}")


class MissingError(LookupError):
    """There is no such run or file."""


@dataclass(frozen=True)
class Settings:
    """What a run is asked for.

    ``model``: a shipped name, or a file of the run; ``held_out``: names of recordings kept for validation; ``left_out``: of those
    that no command uses; ``values``: command -> field -> value, of the fields that were filled in.
    """

    model: str = ""
    held_out: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def changed(self, new: Mapping[str, Any]) -> Settings:
        """These settings with the given ones in their place; values of fields are added to those of their command.

        Raises InputError for an unknown name, type or value.
        """
        known = ("model", "held_out", "left_out", "values")
        for name in new:
            if name not in known:
                raise InputError(
                    f"setting {name[:LONGEST_NAME]!r}", "unknown", f"one of: {', '.join(known)}", nearest(name, known)
                )
        model, values = new.get("model", self.model), dict(self.values)
        if not isinstance(model, str) or len(model) > LONGEST_TEXT or not model.isprintable():
            raise InputError("setting 'model'", "no short text", f"at most {LONGEST_TEXT} printable characters")
        held_out, left_out = (_names(name, new.get(name, getattr(self, name))) for name in ("held_out", "left_out"))
        given = new.get("values", {})
        if not isinstance(given, Mapping):
            raise InputError("setting 'values'", f"{given!r:.40}", "an object: command, then field, then value")
        for command, fields in given.items():
            if not isinstance(fields, Mapping):
                raise InputError(f"setting {command!r:.80}", f"{fields!r:.40}", "an object of fields")
            there = {**values.get(command, {}), **form_for(command).checked(fields)}
            values[command] = {name: value for name, value in there.items() if name not in fields or not _empty(fields[name])}
        return Settings(model.strip(), held_out, left_out, values)


def _names(setting: str, value: Any) -> tuple[str, ...]:
    """Names of recordings. Raises InputError for anything else."""
    good = isinstance(value, list | tuple) and len(value) <= MOST_FILES
    if not good or not all(isinstance(v, str) and len(v) <= LONGEST_TEXT and v.isprintable() for v in value):
        raise InputError(f"setting {setting!r}", "no list of names", "names of recordings")
    return tuple(value)


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
        """The files that were uploaded into a folder of `KINDS`, as paths relative to it, sorted."""
        return files_below(self.folder / kind)

    def entries(self, kind: str) -> dict[str, int]:
        """Name -> number of files of each file and folder that stands in a folder of `KINDS`; of a file: 0."""
        counts: dict[str, int] = {}
        for name in self.files(kind):
            top, inside, _ = name.partition("/")
            counts[top] = counts.get(top, 0) + bool(inside)
        return counts

    @property
    def recordings(self) -> list[str]:
        """Names of the recordings, without their bindings: files, or folders of a known form."""
        return recordings_in(self.folder / RECORDINGS)

    def written(self, command: str) -> list[str]:
        """Files that a command wrote, relative to its folder: pages first, then pictures and films, then others by name."""
        top = self.out(command)
        paths = (p for p in top.rglob("*") if p.is_file() and not p.is_symlink()) if top.is_dir() else ()
        names = [p.relative_to(top).as_posix() for p in paths]
        shown = (n for n in names if not any(part.startswith(".") for part in n.split("/")) and n not in HIDDEN)
        return sorted(shown, key=lambda n: (n.count("/"), _rank(n), n))[:MOST_FILES]

    def place(self, kind: str, name: str) -> Path:
        """Where an uploaded file goes; ``name`` may have folders, as ``robot/assets/link.stl``.

        Raises InputError for an odd path, an ending that is not read, and for too many files.
        """
        if kind not in KINDS:
            raise MissingError(kind)
        safe = safe_path(name) if kind == "model" or "/" in name else safe_name(name)
        if not accepted(kind, safe):
            raise InputError(safe, "a file of a kind that is not read here", f"one of {', '.join(KINDS[kind])}", "convert it")
        if not (self.folder / kind / safe).is_file():
            self.room(kind)
        return self.folder / kind / safe

    def room(self, kind: str) -> int:
        """How many files may be added to a folder of `KINDS`. Raises InputError where it is full."""
        there = len(self.files(kind))
        if there >= MOST_FILES:
            raise InputError(kind, f"{there} files are there", f"at most {MOST_FILES}", "delete some, or start another run")
        return MOST_FILES - there

    def unpack(self, kind: str, archive: Path, name: str) -> Unpacked:
        """Unpack an uploaded ZIP file into a folder of `KINDS`. Raises InputError; see `simgap.app.uploads.unpack`."""
        if kind not in KINDS:
            raise MissingError(kind)
        return unpack(archive, name, self.folder / kind, kind, self.room(kind))

    def remove(self, kind: str, name: str) -> None:
        """Remove an uploaded file, or a folder with all its files, and what the settings say of it. Raises MissingError."""
        if kind not in KINDS or name not in self.entries(kind):
            raise MissingError(name)
        path = self.folder / kind / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        there = self.recordings
        kept = {key: [n for n in getattr(self.settings, key) if n in there] for key in ("held_out", "left_out")}
        self.with_settings(kept | ({} if self.settings.model in self.models() else {"model": ""}))

    def choose_model(self) -> None:
        """Choose among the uploaded models while none is chosen, or one that another includes: the one that no other includes."""
        files = self._uploaded("model", (".xml",))
        chosen = self.settings.model
        main = main_model(self.folder, files)
        if main and (not chosen or chosen in files):
            self.with_settings({"model": main})

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
            return [
                *self._uploaded("files", (BINDING,)),
                *(self.models() if f.models else ()),
                *shipped_scenarios(),
                *shipped_robot_scenarios(),
            ]
        if f.kind is Kind.FILE:
            return [*self._uploaded("files", f.endings), *self._results(f.endings)]
        return [*(f"{RECORDINGS}/{n}" for n in self.recordings), *self._results(SIMPLE)]

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
            used = [n for n in self.recordings if n not in self.settings.left_out]
            held = [n for n in used if n in self.settings.held_out]
            rest = [n for n in used if not (split and n in held)]
            return [f"{RECORDINGS}/{n}" for n in (held if f.name == HELD_OUT else rest)]
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
            raise InputError(f.label, "all of them are held out or left out", "at least one to identify from", "clear one mark")
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
                    copy = run.folder / kind / file
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(like.folder / kind / file, copy)
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
