"""``simgap study``: the report's figures 3 to 8, and its claims, each with its verdict."""

from __future__ import annotations

import os
from pathlib import Path

import click

__all__ = ["command"]


@click.command(epilog="Example: simgap study --out out/study --jobs 2")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for figures, claims.json and the ledger.")
@click.option("--jobs", type=click.IntRange(min=1, max=256), help="Processes side by side (default: two, or one on one core).")
@click.option("--recording", type=click.Path(path_type=Path), help="A log of your robot, for figure 4 in place of the surrogate.")
@click.option("--quick", is_flag=True, help="Few variants: figures and a first look in under a minute.")
@click.option(
    "--docs", type=click.Path(path_type=Path), help="Write the ledger as Markdown here too, figures in a folder beside."
)
@click.option("--json", "as_json", is_flag=True, help="Print claims.json on standard output.")
def command(out: Path, jobs: int | None, recording: Path | None, quick: bool, docs: Path | None, as_json: bool) -> None:
    """Draw the report's figures, put every claim to every variant, and write the ledger.

    Simulates the axis in MuJoCo and in the ODE, identifies it by the report's pipeline and by a better one, and judges 18
    claims by criteria that are fixed in the code. What was computed is kept in OUT/cells: a run that was broken off goes on.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    import json

    from lab.study.run import run_study
    from lab.study.show import progress, show, write_docs
    from mjsim.errors import InputError

    if docs is not None and docs.is_dir():
        raise InputError(docs, "it is a folder", "a Markdown file", f"name {docs / 'study.md'}")
    count = jobs or min(2, os.cpu_count() or 1)
    with progress() as say:
        study = run_study(out, jobs=count, recording=recording, quick=quick, say=say)
    if docs is not None:
        write_docs(study, out, docs)
    if as_json:
        click.echo(json.dumps(study.claims, indent=1))
    else:
        show(study, out)
