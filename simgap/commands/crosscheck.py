"""``simgap crosscheck``: compare MuJoCo with the analytic equations, effect by effect; exit 1 when a tolerance is missed."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from simgap.arguments import Amount, ModelFile, OutputFolder, model_root, take_folder
from simgap.terminal import lines_wanted

__all__ = ["command"]


@click.command(epilog="Example: simgap crosscheck --out out/crosscheck; simgap crosscheck robot.xml")
@click.argument("model", required=False, type=ModelFile())
@model_root
@click.option("--out", type=OutputFolder(), help="Directory for crosscheck.json and crosscheck.png.")
@click.option("--duration", type=Amount(min=0.5), default=10.0, show_default=True, help="Duration of the chirp [s].")
@click.option(
    "--amplitude",
    type=Amount(min=0, min_open=True),
    default=1.0,
    show_default=True,
    help="Amplitude of the chirp [N m | N].",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(model: Path | None, out: Path | None, duration: float, amplitude: float, as_json: bool) -> None:
    """Simulate every effect with MuJoCo (literal, accurate, batch) and the ODE; compare both with an exact reference.

    MODEL is an MJCF of a single-axis chain or of a robot on a fixed base, or the name of a shipped model; default: robot_axis1.
    Of a robot, torque, inertia and acceleration of each joint, servos and a free run are compared with recursive
    Newton-Euler equations, along a trajectory of its own; --duration and --amplitude are of an axis.
    """
    from diagnose.json_file import json_text
    from mjsim.crosscheck import Report, check_all, check_robot_model, plot, table
    from mjsim.errors import CheckError, InputError
    from mjsim.ode import DivergedError
    from mjsim.robot.model import load_robot
    from simgap.robot import is_robot_model

    if out is not None:
        take_folder(out)
    report = Report(())
    shown = not as_json and sys.stderr.isatty()
    try:
        robot = load_robot(model) if model is not None and is_robot_model(model) else None
        items = check_all(model, duration=duration, amplitude=amplitude) if robot is None else check_robot_model(robot)
        for item in items:
            if isinstance(item, Report):
                report = item
            else:
                _tell(item.name, terminal=shown)
    except DivergedError as error:
        raise InputError(model or "robot_axis1", str(error)) from None
    if shown:
        click.echo("\r" + " " * 60 + "\r", nl=False, err=True)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        whole = out / ".crosscheck.json"
        whole.write_text(json_text(report.as_dict()) + "\n", encoding="utf-8")
        whole.replace(out / "crosscheck.json")
        picture = out / ".crosscheck.png"
        plot(report, picture)
        picture.replace(out / "crosscheck.png")
    if as_json:
        click.echo(json_text(report.as_dict()))
    else:
        for line in table(report.rows, robot=report.robot):
            click.echo(line)
        for name, why in report.skipped:
            click.echo(f"not compared: {name}: {why}")
    if report.missed:
        raise CheckError(f"{len(report.missed)} comparisons exceed their tolerance: {'; '.join(report.missed)}")


def _tell(name: str, *, terminal: bool) -> None:
    """What has been compared: in one line of a terminal, or as a line where that is asked for."""
    if terminal:
        click.echo(f"\r{name:60.60s}", nl=False, err=True)
    elif lines_wanted():
        click.echo(f"simgap: {name}", err=True)
