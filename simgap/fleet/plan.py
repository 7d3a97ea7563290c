"""Which recordings a fleet has: one job each, with the robot and the date that their names tell."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from glob import glob
from pathlib import Path
from typing import Any

from mjsim.errors import InputError

__all__ = ["Job", "Settings", "jobs"]

DATE = re.compile(r"(?P<date>\d{4}-?\d{2}-?\d{2}(?:[T_ -]?\d{2}[:.-]?\d{2}(?:[:.-]?\d{2})?)?)")
EXAMPLE = r"as '(?P<robot>arm\d+)'"
FORMATS = {8: "%Y%m%d", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}  # by the number of digits


@dataclass(frozen=True)
class Settings:
    """What all diagnoses of a fleet share: options of `simgap.diagnose`; ``reports``: write report.html of each as well."""

    effects: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    seed: int = 0
    effort: float = 1.0
    accept_log: bool = False
    reports: bool = False


@dataclass(frozen=True)
class Job:
    """One recording to diagnose.

    key: hash of the file's path, size and time of change, of the model and of the settings, so that a job is done once. robot:
    from the name; date: ISO 8601, from the name, else the time of change of the file.
    """

    key: str
    log: str
    model: str
    robot: str
    date: str
    settings: Settings

    def as_dict(self) -> dict[str, Any]:
        """What identifies it, for its record."""
        return {k: v for k, v in dataclasses.asdict(self).items() if k != "settings"}


def jobs(pattern: str, model: Path, settings: Settings, robot: str = "") -> list[Job]:
    """Jobs of all files that match a glob pattern, sorted by path.

    ``robot``: a regular expression with a group ``robot`` (and maybe ``date``), searched in the path; by default the robot is the
    name of the file's folder. A TOML file is a binding and no recording. Raises InputError where nothing matches.
    """
    try:
        expression = re.compile(robot) if robot else None
    except re.error as error:
        raise InputError(
            "--robot", f"{robot!r} is no regular expression ({error})", r"as '(?P<robot>arm\d+)'", "correct it"
        ) from None
    if expression is not None and "robot" not in expression.groupindex:
        raise InputError("--robot", f"{robot!r} has no group 'robot'", EXAMPLE, "add (?P<robot>...)")
    found = sorted(p for p in glob(pattern, recursive=True) if Path(p).is_file() and not p.endswith(".toml"))
    if not found:
        raise InputError(pattern, "no file matches", "a pattern in quotes, as 'logs/**/*.csv'", "check the path")
    shared = hashlib.sha256(model.read_bytes() + repr(settings).encode())
    return [_job(Path(p), model, settings, expression, shared) for p in found]


def _job(path: Path, model: Path, settings: Settings, expression: re.Pattern[str] | None, shared: Any) -> Job:
    stat = path.stat()
    digest = shared.copy()
    digest.update(f"{path.resolve()}|{stat.st_size}|{stat.st_mtime_ns}".encode())
    named: Mapping[str, str | None] = {}
    if expression is not None:
        match = expression.search(path.as_posix())
        if match is None:
            raise InputError(
                path, f"its path does not match --robot {expression.pattern!r}", "a path that does", "change one of them"
            )
        named = match.groupdict()
    name = named.get("robot") or path.resolve().parent.name
    date = _date(named.get("date") or path.name) or datetime.fromtimestamp(stat.st_mtime, UTC).isoformat(timespec="seconds")
    return Job(digest.hexdigest()[:24], str(path), str(model), name, date, settings)


def _date(text: str) -> str | None:
    """The first date in a text as ISO 8601, None where there is none."""
    match = DATE.search(text)
    if match is None:
        return None
    digits = re.sub(r"\D", "", match.group("date"))
    try:
        return datetime.strptime(digits, FORMATS[len(digits)]).replace(tzinfo=UTC).isoformat(timespec="seconds")
    except ValueError:
        return None


def select(all_jobs: Sequence[Job], done: set[str]) -> list[Job]:
    """Those that have no record yet."""
    return [j for j in all_jobs if j.key not in done]
