"""``python -m lab.panel``: run, compare, ablate."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from lab.panel.catalogue import all_cases, choose, quick_cases, select, strata
from lab.panel.record import Record, read_answers, write_answers
from lab.panel.run import LIMIT, Ran, Setting, run_cases
from lab.panel.tree import Tree, at_commit, checkout, here
from mjsim.errors import InputError

__all__ = ["main"]

PANEL = Path("out") / "panel"


def _say(text: str) -> None:
    click.echo(text, err=True)


@contextmanager
def _code(tree: Path | None, commit: str | None, cache: Path) -> Iterator[Tree]:
    """The code that is run: this checkout unless another one, or a commit, is named."""
    if tree is not None and commit is not None:
        raise InputError("--tree and --commit", "both are given", "one of them")
    if commit is None:
        yield checkout(tree or here())
    else:
        with at_commit(commit, cache.parent / "trees") as there:
            yield there


def _cases(quick: bool, names: tuple[str, ...]) -> list[Any]:
    if names:
        return select(names)
    return quick_cases() if quick else list(all_cases())


OPTIONS = (
    click.option("--quick", is_flag=True, help="The quick subset only."),
    click.option("--case", "names", multiple=True, help="This case only; may be repeated."),
    click.option("--tree", type=click.Path(path_type=Path, exists=True, file_okay=False), help="Checkout to run [this one]."),
    click.option("--commit", help="Run this commit, in a git worktree that is removed at the end."),
    click.option("--jobs", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default=True, help="Processes."),
    click.option("--cache", type=click.Path(path_type=Path), default=PANEL / "cases", show_default=True, help="Files of cases."),
    click.option("--limit", type=click.FloatRange(1), default=LIMIT, show_default=True, help="Seconds until a case is an error."),
)


def _with_options(command: Callable[..., Any]) -> Callable[..., Any]:
    for option in reversed(OPTIONS):
        command = option(command)
    return command


@click.group()
def panel() -> None:
    """Regression panel: the same recordings by another commit, or by one rule less."""


@panel.command("list")
@click.option("--quick", is_flag=True, help="The quick subset only.")
def list_(quick: bool) -> None:
    """Names of the cases, with origin and level."""
    for case in _cases(quick, ()):
        click.echo(f"{case.id}  {case.stratum}")


@panel.command()
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the records.")
@_with_options
@click.option("--answers", type=click.Path(path_type=Path, dir_okay=False), help="Also write them to this file, one line a case.")
def run(
    out: Path, quick: bool, names: tuple[str, ...], tree: Path | None, commit: str | None, jobs: int, cache: Path, limit: float,
    answers: Path | None,
) -> None:  # fmt: skip
    """Diagnose the cases; the same call goes on where it was broken off.

    Example: python -m lab.panel run --quick --commit HEAD~1 --out out/panel/before
    """
    with _code(tree, commit, cache) as code:
        ran = run_cases(_cases(quick, names), out, Setting(code, cache, limit=limit), jobs, _say)
        _summary(ran)
        if answers is not None:
            write_answers(answers, list(ran.records.values()), {"commit": code.commit})


def _summary(ran: Ran) -> None:
    records = list(ran.records.values())
    known = [r for r in records if r.good is not None]
    click.echo(f"{len(records)} answers, {ran.kept} of them from before; right {sum(bool(r.good) for r in known)} of {len(known)}")
    for name, why in sorted(ran.absent.items()):
        click.echo(f"{name} was left out: {why}")


def main() -> None:
    """The command line: exit 1 on a loss, 2 on bad input, with one line that says what."""
    try:
        panel(prog_name="python -m lab.panel")
    except InputError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)
