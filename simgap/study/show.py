"""The study on the terminal, and its page among the documentation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mjsim.errors import InputError
from simgap.study.page import page_markdown
from simgap.study.run import Study

__all__ = ["progress", "show", "write_docs"]


@contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """A bar on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
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
    console.print("report's, better: share of the variants of each pipeline that meet the criterion.", highlight=False)
    console.print(
        f"{study.cells} cells, {study.computed} of them new, {study.seconds:.0f} s. Ledger: {out / 'study.html'}", highlight=False
    )


def write_docs(study: Study, out: Path, docs: Path) -> None:
    """The ledger as Markdown at ``docs``, its figures in a folder of the same name beside it."""
    from ident.serial import write_atomic

    try:
        for picture in study.pictures:
            write_atomic(docs.with_suffix("") / f"{picture.name}.png", (out / f"{picture.name}.png").read_bytes())
        write_atomic(docs, page_markdown(study, f"{docs.stem}/"))
    except OSError as error:
        raise InputError(docs, f"cannot write there ({error.strerror})", "a file that can be written") from None
