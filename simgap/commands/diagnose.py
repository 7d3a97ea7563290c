"""``simgap diagnose``: locate, name, model and prove the mismatch."""

from __future__ import annotations

from pathlib import Path

import click

from simgap.arguments import (
    Amount,
    Choice,
    InputFile,
    ModelFile,
    OutputFolder,
    complete_effects,
    model_root,
    spare_inputs,
    take_folder,
)

__all__ = ["command"]


@click.command(
    "diagnose",
    epilog="Example: simgap diagnose log.csv --model robot_axis1 --held-out other.csv --out report/; "
    "simgap diagnose log.csv --model robot.xml --joint elbow --joint wrist --out report/",
)
@click.argument("recordings", nargs=-1, required=True, type=InputFile())
@click.option("--model", required=True, type=ModelFile(), help="Nominal MJCF of the axis, or the name of a shipped model.")
@model_root
@click.option("--out", required=True, type=OutputFolder(), help="Folder for diagnosis.json, corrected.xml and report.html.")
@click.option("--held-out", "held_out", multiple=True, type=InputFile(), help="Recording kept for validation (repeatable).")
@click.option(
    "--judge",
    type=Choice(["motion", "force"]),
    help="Compare the free-run motion, or the force that the recorded motion needs; default: as the binding says. "
    "Not of a robot.",
)
@click.option(
    "--effects",
    default="",
    shell_complete=complete_effects,
    help="Consider only these effects: identifiers with commas (simgap effects lists them).",
)
@click.option(
    "--jobs",
    default=2,
    show_default=True,
    type=click.IntRange(1),
    help="Threads of the search, one for a robot. The answer does not depend on their number.",
)
@click.option("--seed", default=0, show_default=True, type=int, help="Seed of the random generators.")
@click.option(
    "--budget",
    default=0.0,
    type=Amount(0.0),
    help="Seconds after which the search ends (0: no limit). Validation, runs of the files in plain MuJoCo and the report "
    "come on top.",
)
@click.option(
    "--effort",
    default=1.0,
    show_default=True,
    type=Amount(0.0),
    help="Limit of the simulations in the search: 1 takes about half a minute for 10 s at 2 kHz on two cores; 0: no limit. "
    "Unlike --budget, it gives the same answer on every machine. A robot has no such limit.",
)
@click.option("--accept-log", is_flag=True, help="Search even where the check of the log says that it has to be fixed first.")
@click.option(
    "--joint",
    "joints",
    multiple=True,
    help="The joint to diagnose, of a log that holds several; of a robot repeatable; default: the driven one, or all that move.",
)
@click.option("--film", is_flag=True, help="Put a short film of the model and a recording into the report; some seconds more.")
@click.option("--markdown", is_flag=True, help="Write summary.md as well: the answer as Markdown, for a pull request.")
@click.option("--json", "as_json", is_flag=True, help="Print diagnosis.json on standard output.")
@click.option("--quiet", is_flag=True, help="No progress on standard error.")
def command(
    recordings: tuple[Path, ...],
    model: Path,
    out: Path,
    held_out: tuple[Path, ...],
    judge: str | None,
    effects: str,
    jobs: int,
    seed: int,
    budget: float,
    effort: float,
    accept_log: bool,
    joints: tuple[str, ...],
    film: bool,
    markdown: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Locate, name, model and prove the mismatch between RECORDINGS and a nominal model."""
    import json

    take_folder(out)
    written = ("diagnosis.json", "corrected.xml", "mapped.xml", "report.html", "summary.md")
    spare_inputs([out / name for name in written], [*recordings, *held_out, model])
    only = tuple(e.strip() for e in effects.split(",") if e.strip())
    from simgap.api.diagnosing import diagnose
    from simgap.pipeline import STATE

    try:
        found = diagnose(
            list(recordings), model, held_out=list(held_out), out=out, judge=judge, effects=only, joints=joints, jobs=jobs,
            seed=seed, budget=budget, effort=effort, accept_log=accept_log, progress=not quiet,
        )  # fmt: skip
    except KeyboardInterrupt:
        kept = out / STATE
        left = f"the fits are kept in {kept}: the same command continues" if kept.exists() else "nothing was written"
        click.echo(f"simgap: interrupted; {left}", err=True)
        raise SystemExit(130) from None
    if markdown:
        found.summary_file(out / "summary.md")
    if film:
        found.report(out / "report.html", film_of=[*recordings, *held_out])
    if as_json:
        click.echo(json.dumps(json.loads((out / "diagnosis.json").read_text(encoding="utf-8")), indent=2))
    else:
        from simgap.show import show_found

        show_found(found, out)
