"""``simgap diagnose``: locate, name, model and prove the mismatch."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["command"]


@click.command(
    "diagnose",
    epilog="Example: simgap diagnose log.csv --model models/robot_axis1.xml --held-out other.csv --out report/",
)
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--model", required=True, type=click.Path(path_type=Path), help="Nominal MJCF of the axis.")
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Folder for diagnosis.json, corrected.xml and report.html."
)
@click.option(
    "--held-out", "held_out", multiple=True, type=click.Path(path_type=Path), help="Recording kept for validation (repeatable)."
)
@click.option(
    "--judge", type=click.Choice(["motion", "force"]), help="Judge by free-run motion or by force; default: as the binding says."
)
@click.option("--effects", default="", help="Comma-separated identifiers: consider only these.")
@click.option("--jobs", default=2, show_default=True, type=click.IntRange(1), help="Threads; the answer does not depend on them.")
@click.option("--seed", default=0, show_default=True, type=int, help="Seed of whatever is random.")
@click.option("--budget", default=0.0, type=float, help="Seconds after which no further structure is tried (0: no limit).")
@click.option(
    "--effort",
    default=1.0,
    show_default=True,
    type=click.FloatRange(0.0),
    help="How many simulations the search may take: 1 is about half a minute for 10 s at 2 kHz on two cores; 0: no limit. "
    "Unlike --budget it gives the same answer on every machine.",
)
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
    as_json: bool,
    quiet: bool,
) -> None:
    """Locate, name, model and prove the mismatch between RECORDINGS and a nominal model."""
    import json
    import math

    from diagnose.report.render_worker import Drawers

    with Drawers(jobs) as draw:  # they load what draws while this process loads the rest
        from diagnose.pipeline import Options
        from mjsim.effects import registered
        from mjsim.errors import InputError
        from simgap.pipeline import STATE, diagnose_files

        only = tuple(e.strip() for e in effects.split(",") if e.strip())
        for name in only:
            if name not in registered():
                raise InputError("--effects", f"unknown effect {name!r}", ", ".join(registered()), "correct the name")
        options = Options(judge=judge, effects=only, jobs=jobs, seed=seed, seconds=budget or math.inf, effort=effort or math.inf)
        try:
            result = diagnose_files(recordings, model, out, held_out, options, progress=not quiet, draw=draw)
        except KeyboardInterrupt:
            kept = out / STATE
            left = f"what was fitted is in {kept}: give the same command to go on" if kept.exists() else "nothing was written"
            click.echo(f"simgap: interrupted; {left}", err=True)
            raise SystemExit(130) from None
    if as_json:
        click.echo(json.dumps(json.loads((out / "diagnosis.json").read_text(encoding="utf-8")), indent=2))
    else:
        from simgap.show import show_diagnosis

        show_diagnosis(result, out)
