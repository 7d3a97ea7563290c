"""``simgap run``: simulate a scenario file, or a shipped scenario by name, and write its 2 kHz log."""

from __future__ import annotations

import json
from pathlib import Path

import click

from simgap.arguments import Choice, ModelFile, NamedSource, OutputFolder, model_root, spare_inputs, take_folder
from simgap.terminal import printable

__all__ = ["command"]


@click.command(epilog="Example: simgap run coulomb_2 --out logs/")
@click.argument("scenario", required=False, type=NamedSource())
@click.option("--out", type=OutputFolder(), help="Directory for the log and its provenance.")
@click.option("--list", "listing", is_flag=True, help="List the shipped scenarios.")
@click.option("--engine", type=Choice(["ode", "accurate", "literal"]), help="Overrides the scenario's engine.")
@click.option("--format", "file_format", type=Choice(["csv", "parquet"]), help="Overrides the scenario's file format.")
@click.option("--seed", type=int, help="Overrides the scenario's seed.")
@click.option("--duration", type=float, help="Overrides the scenario's duration [s].")
@click.option("--model", type=ModelFile(), help="Overrides the scenario's model: an MJCF file or a shipped name.")
@model_root
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    scenario: str | None,
    out: Path | None,
    listing: bool,
    engine: str | None,
    file_format: str | None,
    seed: int | None,
    duration: float | None,
    model: Path | None,
    as_json: bool,
) -> None:
    """Simulate SCENARIO (a TOML file or a shipped name) and write its log."""
    from mjsim.errors import InputError
    from mjsim.ode import DivergedError
    from mjsim.scenario import load_scenario, provenance, shipped_scenarios, write_log
    from mjsim.scenario import run as run_scenario

    if listing:
        shipped = shipped_scenarios()
        if as_json:
            click.echo(json.dumps(shipped, indent=2))
        else:
            width = max(map(len, shipped))
            for name, about in shipped.items():
                click.echo(f"{name:{width}s}  {about}")
        return
    if scenario is None or out is None:
        raise click.UsageError("name a SCENARIO and --out DIR (simgap run --list shows the shipped ones)")
    take_folder(out)
    chosen = load_scenario(
        scenario,
        engine=engine,
        format=file_format,
        seed=seed,
        duration_s=duration,
        model=None if model is None else str(model.resolve()),
    )
    spare_inputs([out / f"{chosen.name}.{chosen.format.value}", out / f"{chosen.name}.toml"], [Path(scenario)])
    try:
        log = run_scenario(chosen)
    except DivergedError as error:
        raise InputError(f"scenario {chosen.name!r}", str(error)) from None
    path = write_log(log, out)
    if as_json:
        click.echo(json.dumps({"log": str(path), **provenance(log)}, indent=2))
    else:
        count = len(log.motion.time)
        click.echo(
            printable(str(path))
            + f": {count} samples at {1 / chosen.sample_time_s:g} Hz, engine {chosen.engine.value}, seed {chosen.seed}"
        )
        for effect in log.axis.effects:
            click.echo(f"  {effect.describe()}")
