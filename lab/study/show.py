"""The study on the terminal, and its page among the documentation."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lab.study.page import page_markdown
from lab.study.study import Study
from mjsim.errors import InputError

__all__ = ["progress", "show", "write_docs"]


SPARING = 10.0
"""Seconds between two lines of one stage, where lines stay."""


def _lines() -> Callable[[str, int, int], None]:
    """A line when the stage changes and otherwise no more than one in a while, with what is left to do."""
    began = time.monotonic()
    stage, last, first_done, first_time = "", -SPARING, 0, 0.0

    def tell(text: str, done: int, total: int) -> None:
        nonlocal stage, last, first_done, first_time
        now = time.monotonic() - began
        if text != stage:
            first_done, first_time = done, now
        elif now - last < SPARING and done != total:
            return
        stage, last = text, now
        line = f"simgap: {now:4.0f} s  {text}"
        if total:
            line += f"  {done} of {total}"
            if first_done < done < total and now > first_time:
                line += f", about {(total - done) * (now - first_time) / (done - first_done):.0f} s left"
        print(line, file=sys.stderr, flush=True)

    return tell


@contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """A bar on standard error; where that is no terminal, a line now and then."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=None)

        def say(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total or None)

        yield say


def show(study: Study, out: Path) -> None:
    """Verdicts as a table."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table("id", "claim", "verdict", "report's", "better")
    for e in study.entries:
        shares = [f"{100 * e.shares[f]:.0f} %" if f in e.shares else "-" for f in ("report", "better")]
        verdict = e.verdict.value + (" (artefact)" if e.artefact else "")
        table.add_row(e.claim.id, e.claim.text, f"[bold]{verdict}[/bold]", *shares)
    console.print(table)
    console.print(
        "Columns report's and better: share of the variants that meet the criterion with each pipeline.", highlight=False
    )
    console.print(
        f"{study.cells} cells, {study.computed} of them new, {study.seconds:.0f} s. Ledger: {out / 'study.html'}", highlight=False
    )


def write_docs(study: Study, out: Path, docs: Path) -> None:
    """The ledger as Markdown at ``docs``, its figures in a folder of the same name beside it."""
    from ident.serial import write_set

    try:
        contents: dict[Path, str | bytes] = {
            docs.with_suffix("") / f"{p.name}.png": (out / f"{p.name}.png").read_bytes() for p in study.pictures
        }
        write_set(contents | {docs: page_markdown(study, f"{docs.stem}/")})
    except OSError as error:
        raise InputError(docs, f"cannot be written ({error.strerror})", "a writable file") from None
