"""``simgap check``: what was understood of model and log, what is wrong with the log, what it can and cannot show."""

from __future__ import annotations

from pathlib import Path

import click

from simgap.arguments import InputFile, ModelFile, OutputFolder, model_root, spare_inputs, take_folder

__all__ = ["command"]


@click.command("check", epilog="Example: simgap check log.csv --model robot_axis1 --out check/")
@click.argument("recordings", nargs=-1, required=True, type=InputFile())
@click.option(
    "--model", required=True, type=ModelFile(), help="Nominal MJCF of the axis or robot, or the name of a shipped model."
)
@model_root
@click.option("--out", type=OutputFolder(), help="Folder for check.json and check.html.")
@click.option("--json", "as_json", is_flag=True, help="Print check.json on standard output.")
def command(recordings: tuple[Path, ...], model: Path, out: Path | None, as_json: bool) -> None:
    """Check RECORDINGS against a nominal model before any physics is sought.

    Says what was understood, what is wrong with the log (units, signs, clocks, sampling, clipping), and which effects the
    excitation can show. Of a robot, each joint is checked, and whether columns of different joints are swapped. Exit 0: ready,
    or usable with limits. 1: the log has to be fixed first. 2: bad input.
    """
    from diagnose.check import LogVerdict
    from diagnose.json_file import json_text
    from simgap.api.checking import check

    if out is not None:
        take_folder(out)
        spare_inputs((out / name for name in ("check.json", "check.html")), (model, *recordings))
    result = check(list(recordings), model, out=out)
    if as_json:
        click.echo(json_text({"model": model.name, **result.as_dict()}))
    else:
        from simgap.show import show_check

        show_check(result)
        if out is not None:
            click.echo(f"wrote {out / 'check.html'} and {out / 'check.json'}")
    if result.verdict is LogVerdict.FIX:
        raise SystemExit(1)
