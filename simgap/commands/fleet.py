"""``simgap fleet``: diagnose many recordings of many robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from simgap.arguments import Amount, InputPattern, ModelFile, OutputFolder, complete_effects, model_root, take_folder

__all__ = ["command"]


@click.command(
    "fleet", epilog="Example: simgap fleet 'logs/*/*.parquet' --model arm.xml --out fleet/ --workers 8",
)  # fmt: skip
@click.argument("pattern", type=InputPattern())
@click.option("--model", required=True, type=ModelFile(), help="Nominal MJCF of all robots, or the name of a shipped model.")
@model_root
@click.option("--out", required=True, type=OutputFolder(), help="Folder for fleet.parquet, fleet.html and the records.")
@click.option("--scheduler", default="", help="Address of a Dask scheduler; default: a local cluster.")
@click.option("--workers", default=2, show_default=True, type=click.IntRange(1), help="Processes of the local cluster.")
@click.option("--memory", default="auto", show_default=True, help="Memory limit of each of them, as 2GB.")
@click.option("--robot", default="", help="Regular expression with (?P<robot>...), and maybe (?P<date>...), for the path "
              "of a recording; default: the robot is the name of the folder.")  # fmt: skip
@click.option(
    "--effects", default="", shell_complete=complete_effects, help="Consider only these effects: identifiers with commas."
)
@click.option("--joint", "joints", multiple=True, help="The joints to diagnose (repeatable); default: all that move.")
@click.option("--effort", default=1.0, show_default=True, type=Amount(0.0), help="Limit of the simulations, as for diagnose.")
@click.option("--seed", default=0, show_default=True, type=int, help="Seed of the random generators.")
@click.option("--reports", is_flag=True, help="Write diagnosis.json, corrected.xml and report.html of each recording too.")
@click.option("--accept-log", is_flag=True, help="Search even where the check of a log says that it has to be fixed first.")
@click.option("--require-all", is_flag=True, help="Exit 1 when any recording could not be diagnosed.")
@click.option("--json", "as_json", is_flag=True, help="Print the counts as JSON.")
@click.option("--quiet", is_flag=True, help="No progress on standard error.")
def command(
    pattern: str, model: Path, out: Path, scheduler: str, workers: int, memory: str, robot: str, effects: str,
    joints: tuple[str, ...], effort: float, seed: int, reports: bool, accept_log: bool, require_all: bool, as_json: bool,
    quiet: bool,
) -> None:  # fmt: skip
    """Diagnose every recording that matches PATTERN (in quotes): one table of all findings and one page.

    A recording that has been diagnosed is not diagnosed again: the same command continues after a break, and adds new recordings.
    One whose diagnosis failed, as by a lost worker, is tried again. A recording that is refused or fails stands in the table
    with the reason; the exit code is 0, 2 when none could be diagnosed, and 1 when --require-all is given and one could not.
    """
    import json
    import math

    take_folder(out)
    from simgap.api.diagnosing import need_effects
    from simgap.api.model import Model
    from simgap.fleet.page import counted, headline, write_page
    from simgap.fleet.plan import Settings, jobs
    from simgap.fleet.run import forget_failed, run
    from simgap.fleet.table import read_records, rows, without_diagnosis, write_parquet

    only = tuple(e.strip() for e in effects.split(",") if e.strip())
    need_effects(only, robot=Model(model).is_robot)
    settings = Settings(only, joints, seed, effort or math.inf, accept_log, reports)
    planned = jobs(pattern, model, settings, robot)
    out.mkdir(parents=True, exist_ok=True)

    def told(finished: int, total: int) -> None:
        if not quiet:
            click.echo(f"simgap: {finished} of {total} recordings", err=True)

    forget_failed(planned, out)
    run(planned, out, scheduler=scheduler, workers=workers, memory=memory, progress=told)
    table = [row for record in read_records(out, (j.key for j in planned)) for row in rows(record)]
    write_parquet(out / "fleet.parquet", table)
    write_page(out / "fleet.html", table, str(model.name))
    robots = {r["robot"] for r in table}
    if as_json:
        counts: dict[str, int] = {}
        for r in {r["key"]: r["verdict"] for r in table}.values():
            counts[r] = counts.get(r, 0) + 1
        click.echo(json.dumps({"robots": len(robots), "recordings": len(planned), "verdicts": counts}))
    else:
        click.echo(f"{counted(len(robots), 'robot')}, {counted(len(planned), 'recording')}: {headline(table)}")
        click.echo(f"Page: {out / 'fleet.html'}   Table: {out / 'fleet.parquet'}")
    _need_diagnoses(pattern, without_diagnosis(table), len(planned), out / "fleet.html", require_all)


def _need_diagnoses(pattern: str, missing: Sequence[Mapping[str, Any]], total: int, page: Path, require_all: bool) -> None:
    """Raise InputError where none of the recordings was diagnosed, and CheckError where ``require_all`` and one was not."""
    from mjsim.errors import CheckError, InputError

    if not missing:
        return
    several = "" if len(missing) == 1 else f"; {page} has all reasons"
    why = f"{missing[0]['log']}: {missing[0]['problem']}{several}"
    if len(missing) == total:
        none = "none of its recordings could be diagnosed" if total > 1 else "it could not be diagnosed"
        raise InputError(pattern, none, todo=why)
    if require_all:
        raise CheckError(f"{pattern}: {len(missing)} of {total} recordings could not be diagnosed; {why}")
