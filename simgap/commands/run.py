"""``simgap run``: simulate a scenario file, a shipped scenario by name, or a robot on an exciting trajectory; write the log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simgap.arguments import Choice, ModelFile, NamedSource, OutputFolder, model_root, spare_inputs, take_folder
from simgap.terminal import printable

if TYPE_CHECKING:
    from mjsim.robot.scenario import RobotScenario

__all__ = ["command"]


@click.command(epilog="Example: simgap run coulomb_2 --out logs/; simgap run robot.xml --out logs/")
@click.argument("scenario", required=False, type=NamedSource(models=True))
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
    """Simulate SCENARIO (a TOML file or a shipped name) and write its log.

    A robot on a fixed base, as an MJCF file or a shipped model, may stand in the place of SCENARIO: its joints then follow an
    exciting trajectory within their limits, under the torques or the servos of the model.
    """
    from mjsim.errors import InputError
    from mjsim.ode import DivergedError
    from mjsim.robot.scenario import robot_scenario, shipped_robot_scenarios
    from mjsim.scenario import load_scenario, provenance, shipped_scenarios, write_log
    from mjsim.scenario import run as run_scenario

    if listing:
        shipped = shipped_scenarios() | shipped_robot_scenarios()
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
    given = {
        "format": file_format, "seed": seed, "duration_s": duration, "model": None if model is None else str(model.resolve())
    }  # fmt: skip
    robot = robot_scenario(scenario, **given)
    if robot is not None:
        if engine is not None:
            raise InputError("--engine", repr(engine), "no engine: a robot is stepped by MuJoCo", "leave it out")
        _run_robot(robot, scenario, out, as_json=as_json)
        return
    chosen = load_scenario(scenario, engine=engine, **given)
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


def _run_robot(chosen: RobotScenario, source: str, out: Path, *, as_json: bool) -> None:
    from mjsim.robot.scenario import run_robot, write_robot_log

    spare_inputs([out / f"{chosen.name}.{chosen.format.value}"], [Path(source), chosen.model_path])
    log = run_robot(chosen)
    path, origin = write_robot_log(log, out)
    if as_json:
        click.echo(json.dumps({"log": str(path), **origin}, indent=2))
        return
    count = len(log.columns["time_s"])
    click.echo(
        printable(str(path)) + f": {count} samples at {1 / chosen.sample_time_s:g} Hz, {len(log.robot.joints)} joints, "
        f"seed {chosen.seed}"
    )
    smaller = f", {100 * log.wanted.shrunk:.0f} % of the size allowed" if log.wanted.shrunk < 1 else ""
    click.echo(f"  trajectory of condition number {log.wanted.condition:.3g}{smaller}")
    if chosen.payload is not None:
        click.echo(f"  payload of {chosen.payload.mass:g} kg on {chosen.payload.body}")
    for effect in chosen.effects:
        values = ", ".join(f"{k} = {v:.4g}" for k, v in effect.items() if isinstance(v, int | float))
        click.echo(f"  {effect['id']} at {effect['joint']}: {values}")
