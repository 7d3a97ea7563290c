"""``simgap study``: reproduce a published study's figures 3 to 8 and judge each of its claims."""

from __future__ import annotations

import os
from pathlib import Path

import click

from simgap.arguments import InputFile, OutputFolder, take_file, take_folder

__all__ = ["command"]


@click.command(epilog="Example: simgap study --out out/study --jobs 2")
@click.option("--out", type=OutputFolder(), required=True, help="Folder for figures, claims.json and the ledger.")
@click.option("--jobs", type=click.IntRange(min=1, max=256), help="Number of processes (default: two, or one on one core).")
@click.option("--recording", type=InputFile(), help="A log of your robot, used in figure 4 instead of a simulated one.")
@click.option("--quick", is_flag=True, help="Fewer variants: takes less than a minute.")
@click.option(
    "--docs",
    type=click.Path(path_type=Path),
    help="Also write the ledger to this Markdown file, with the figures in a folder beside it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print claims.json on standard output.")
def command(out: Path, jobs: int | None, recording: Path | None, quick: bool, docs: Path | None, as_json: bool) -> None:
    """Draw the study's figures, test every claim on every variant, and write the ledger.

    Simulates the axis in MuJoCo and in the ODE, identifies it with the study's pipeline and with a better one, and judges 18
    claims by criteria that are fixed in the code. Results are kept in OUT/cells, so an interrupted run continues.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    import json

    from lab.study.run import run_study
    from lab.study.show import progress, show, write_docs

    take_folder(out)
    if docs is not None:
        take_file(docs, "choose another --docs")
    count = jobs or min(2, os.cpu_count() or 1)
    with progress() as say:
        study = run_study(out, jobs=count, recording=recording, quick=quick, say=say)
    if docs is not None:
        write_docs(study, out, docs)
    if as_json:
        click.echo(json.dumps(study.claims, indent=1))
    else:
        show(study, out)
