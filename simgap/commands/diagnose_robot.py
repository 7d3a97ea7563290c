"""``simgap diagnose`` of a robot: all joints of one log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

__all__ = ["run_robot"]


def run_robot(
    recordings: Sequence[Path],
    model: Path,
    out: Path,
    held_out: Sequence[Path],
    joints: Sequence[str],
    effects: str,
    seed: int,
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    """Diagnose a robot and show the answer on the terminal."""
    import json

    from diagnose.robot.laws import identifiers
    from diagnose.robot.options import RobotOptions
    from mjsim.effects import registered
    from mjsim.errors import InputError
    from simgap.robot import diagnose_robot_files

    only = tuple(e.strip() for e in effects.split(",") if e.strip())
    for name in only:
        if name not in identifiers():
            why = "cannot be told by force" if name in registered() else "is not known"
            raise InputError("--effects", f"effect {name!r} {why}", ", ".join(identifiers()), "correct the name")
    say = (lambda line: None) if quiet else (lambda line: click.echo(line, err=True))
    result = diagnose_robot_files(recordings, model, out, held_out, RobotOptions(tuple(joints), only, seed=seed), say)
    if as_json:
        click.echo(json.dumps(json.loads((out / "diagnosis.json").read_text(encoding="utf-8")), indent=2))
        return
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(f"[bold]{result.verdict.value}[/bold]  {result.summary}", highlight=False)
    table = Table("joint", "verdict", "missing", "held-out error of the file", "refitted", "corrected", "still predictable")
    for name, r in result.joints.items():
        missing = "\n".join(
            f"{f.effect} "
            + ", ".join(f"{k} {e.value:.4g} +- {(e.ci95[1] - e.ci95[0]) / 2:.2g} {e.unit}" for k, e in f.parameters.items())
            for f in r.findings
        )
        errors = [f"{100 * r.fit[k].held_out_nrmse:.2f} %" for k in ("nominal", "refitted", "corrected")]
        table.add_row(name, r.verdict.value, missing, *errors, f"{100 * max(r.remains[0], 0.0):.1f} %")
    console.print(table)
    for note in result.notes:
        console.print(note, highlight=False)
    console.print(f"Report: {out / 'report.html'}   ({result.seconds:.0f} s)", highlight=False)
