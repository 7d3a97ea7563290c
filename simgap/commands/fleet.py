"""``simgap fleet``: diagnose many recordings of many robots."""

from __future__ import annotations

from pathlib import Path

import click

from simgap.arguments import InputPattern, ModelFile, OutputFolder, complete_effects, model_root, take_folder

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
@click.option(
    "--effort", default=1.0, show_default=True, type=click.FloatRange(0.0), help="Limit of the simulations, as for diagnose."
)
@click.option("--seed", default=0, show_default=True, type=int, help="Seed of the random generators.")
@click.option("--reports", is_flag=True, help="Write diagnosis.json, corrected.xml and report.html of each recording too.")
@click.option("--accept-log", is_flag=True, help="Search even where the check of a log says that it has to be fixed first.")
@click.option("--json", "as_json", is_flag=True, help="Print the counts as JSON.")
@click.option("--quiet", is_flag=True, help="No progress on standard error.")
def command(
    pattern: str, model: Path, out: Path, scheduler: str, workers: int, memory: str, robot: str, effects: str,
    joints: tuple[str, ...], effort: float, seed: int, reports: bool, accept_log: bool, as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Diagnose every recording that matches PATTERN (in quotes): one table of all findings and one page.

    A recording that has been diagnosed is not diagnosed again: the same command continues after a break, and adds new recordings.
    """
    import json
    import math

    take_folder(out)
    from simgap.api.diagnosing import need_effects
    from simgap.api.model import Model
    from simgap.fleet.page import counted, headline, write_page
    from simgap.fleet.plan import Settings, jobs
    from simgap.fleet.run import run
    from simgap.fleet.table import read_records, rows, write_parquet

    only = tuple(e.strip() for e in effects.split(",") if e.strip())
    need_effects(only, robot=Model(model).is_robot)
    settings = Settings(only, joints, seed, effort or math.inf, accept_log, reports)
    planned = jobs(pattern, model, settings, robot)
    out.mkdir(parents=True, exist_ok=True)

    def told(finished: int, total: int) -> None:
        if not quiet:
            click.echo(f"simgap: {finished} of {total} recordings", err=True)

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
