"""The app's pages: the list of runs, the stages of one run, a comparison. Theme and components are those of the report."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path

import jinja2

from diagnose.report.components import theme_button
from diagnose.report.document import theme
from mjsim.models import shipped_models
from simgap.app.answers import checked, compared, diagnosed, written
from simgap.app.jobs import Jobs
from simgap.app.runs import KINDS, MOST_UPLOAD, Run

__all__ = ["comparison", "home", "problem", "run_page", "script", "style"]


@cache
def _environment() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
                                     lstrip_blocks=True)  # fmt: skip
    environment.globals["theme_button"] = theme_button
    return environment


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
    """Model, recordings, check, diagnosis and results of one run."""
    job = jobs.of(run)
    ended = run.ended()
    broken_off = bool(ended) and ended["code"] is None and not jobs.running(run)
    error = "broken off with the server; start again: the fits that were made are kept" if broken_off else ended.get("error", "")
    return _environment().get_template("run.html.j2").render(
        title=run.name, run=run, s=run.settings, shipped=shipped_models(), kinds=KINDS, most=f"{MOST_UPLOAD >> 20} MiB",
        own=[n for n in run.files("model") if n.lower().endswith(".xml")],
        working=job.command if job is not None and jobs.running(run) else "",
        failed=ended.get("command", ""), error=error, check=checked(run), answer=diagnosed(run),
        check_files=written(run, "check"), files=written(run, "diagnose"),
    )  # fmt: skip


def comparison(runs: Sequence[Run]) -> str:
    """Runs beside each other."""
    return _environment().get_template("compare.html.j2").render(title="Compare runs", table=compared(runs), count=len(runs))


def problem(text: str) -> str:
    """A page that says what is wrong, in one line."""
    return _environment().get_template("problem.html.j2").render(title="simgap app", text=text)
