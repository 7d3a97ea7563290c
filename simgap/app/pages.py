"""The app's pages: the list of runs, the stages of one run, one command, a comparison.

Theme and components are those of the report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from diagnose.report.components import theme_button
from diagnose.report.document import theme
from mjsim.models import shipped_models
from mjsim.robot.scenario import shipped_robot_scenarios
from mjsim.scenario import shipped_scenarios
from simgap.app.answers import checked, compared, diagnosed
from simgap.app.forms import Field, Form, Kind, forms
from simgap.app.jobs import Jobs
from simgap.app.record import Ending, Record, record
from simgap.app.runs import FILES, HELD_OUT, RECORDINGS, Run
from simgap.app.uploads import ARCHIVE, BESIDE, KINDS, MOST_UPLOAD

__all__ = ["command_page", "comparison", "home", "problem", "run_page", "script", "style"]

STAGES = ("check", "diagnose")  # commands with a step of their own on the page of a run
_GROUPS = (("model/", "uploaded"), ("recordings/", "uploaded"), ("files/", "uploaded"), ("out/", "written by a command"))


@dataclass(frozen=True)
class Entry:
    """A field as a page shows it: its value, what is used while it is empty, and choices in groups (value, text)."""

    field: Field
    value: Any
    empty: str
    groups: Sequence[tuple[str, Sequence[tuple[str, str]]]]

    @property
    def needed(self) -> bool:
        """Whether it has to be looked at: nothing is used while it is empty, or the user filled it in."""
        return self.value is not None or (self.field.required and self.empty == "choose") or self.field.kind is Kind.SOURCE


@dataclass(frozen=True)
class Shown:
    """What a page shows of a command: its form, the last start, the files that it wrote, and whether it works now."""

    form: Form
    entries: Sequence[Entry]
    record: Record | None
    files: Sequence[str]
    working: bool

    @property
    def refused(self) -> bool:
        """Whether the last start gave no result."""
        return self.record is not None and self.record.ending in (Ending.REFUSED, Ending.STOPPED, Ending.BROKEN_OFF)


@cache
def _environment() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
                                     lstrip_blocks=True)  # fmt: skip
    environment.globals |= {"theme_button": theme_button, "Kind": Kind, "kinds": KINDS, "archive": ARCHIVE, "beside": BESIDE,
                            "most": f"{MOST_UPLOAD >> 20} MiB"}  # fmt: skip
    environment.filters["code"] = _code
    return environment


def _code(text: str) -> Markup:
    """Text whose parts between backquotes are code."""
    parts = text.split("`")
    return Markup("").join(Markup("<code>{}</code>").format(p) if k % 2 else p for k, p in enumerate(parts))


@cache
def style() -> str:
    """The report's style sheet with the few rules of the app."""
    return theme() + (files("simgap.app") / "app.css").read_text(encoding="utf-8")


@cache
def script() -> str:
    """The report's switch of colours and the app's script."""
    own = (files("simgap.app") / "app.js").read_text(encoding="utf-8")
    return (files("diagnose.report") / "theme.js").read_text(encoding="utf-8") + own


def home(runs: Sequence[Run], jobs: Jobs) -> str:
    """All runs, with a form for a new one."""
    working = {run.id for run in runs if jobs.running(run)}
    return _environment().get_template("home.html.j2").render(title="Runs", runs=runs, working=working, table=compared(runs))


def run_page(run: Run, jobs: Jobs) -> str:
    """Model, recordings, check, diagnosis, results and the other commands of one run."""
    return _environment().get_template("run.html.j2").render(
        title=run.name, run=run, s=run.settings, models=_grouped(run.models(), shipped_models()), busy=_busy(run, jobs),
        check=shown(run, jobs, "check"), diagnose=shown(run, jobs, "diagnose"), checked=checked(run), answer=diagnosed(run),
        others=[(form, record(run, name)) for name, form in forms().items() if name not in STAGES],
    )  # fmt: skip


def command_page(run: Run, jobs: Jobs, command: str) -> str:
    """The form of a command, its progress, and what it said and wrote."""
    c = shown(run, jobs, command)
    uploads = any(e.field.kind in (Kind.FILE, Kind.SOURCE) for e in c.entries)
    return (
        _environment()
        .get_template("command.html.j2")
        .render(title=f"{command}: {run.name}", run=run, s=run.settings, c=c, busy=_busy(run, jobs), uploads=uploads)
    )


def shown(run: Run, jobs: Jobs, command: str) -> Shown:
    """What a page shows of a command of a run."""
    form = forms()[command]
    values = run.settings.values.get(command, {})
    entries = [_entry(run, form, f, values) for f in form.fields if f.name not in (RECORDINGS, HELD_OUT)]
    return Shown(form, entries, record(run, command), run.written(command), _busy(run, jobs) == command)


def _busy(run: Run, jobs: Jobs) -> str:
    """The command that works now."""
    job = jobs.of(run)
    return job.command if job is not None and jobs.running(run) else ""


def _entry(run: Run, form: Form, f: Field, values: Mapping[str, Any]) -> Entry:
    value = values.get(f.name)
    if f.kind in FILES:
        automatic = run.automatic(form, f)
        empty = f"{_short(automatic[0])} (automatic)" if automatic else "choose" if f.required else "none"
        shipped = [*shipped_models(), *shipped_scenarios(), *shipped_robot_scenarios()]
        return Entry(f, value, empty, _grouped(run.candidates(f), shipped))
    if f.kind is Kind.CHOICE:
        empty = f"{f.default} (default)" if f.default is not None else "choose" if f.required else "default"
        return Entry(f, value, empty, [("", [(c, c) for c in f.choices if c != f.default])])
    default = f"{f.default:g}" if isinstance(f.default, float) else str(f.default)
    return Entry(f, value, "" if f.default is None or f.kind is Kind.FLAG else default, ())


def _short(path: str) -> str:
    """A path without the folder of uploads."""
    return path.partition("/")[2] if path.startswith(("model/", "recordings/", "files/", "out/")) else path


def _grouped(names: Sequence[str], shipped: Sequence[str] | Mapping[str, str]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Files in groups: uploaded, written, shipped; (value, text)."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for name in names:
        group = next((g for start, g in _GROUPS if name.startswith(start)), "shipped" if name in shipped else "")
        groups.setdefault(group, []).append((name, _short(name)))
    return list(groups.items())


def comparison(runs: Sequence[Run]) -> str:
    """Runs beside each other."""
    return _environment().get_template("compare.html.j2").render(title="Compare runs", table=compared(runs), count=len(runs))


def problem(text: str) -> str:
    """A page that says what is wrong, in one line."""
    return _environment().get_template("problem.html.j2").render(title="simgap app", text=text)
