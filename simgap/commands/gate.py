"""``simgap gate``: exit 1 when a model predicts recordings worse than a baseline diagnosis says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simgap.arguments import Amount, Choice, InputFile, ModelFile, OutputFile, model_root, spare_inputs, take_file

if TYPE_CHECKING:
    from simgap.gating.check import Check

__all__ = ["as_markdown", "command", "judged"]


def judged(model: Path, recordings: Sequence[Path], baseline: Path, against: str, tolerance: float) -> list[Check]:
    """Checks of a model, of an axis or of a robot, on recordings against a baseline's figures. Raises InputError."""
    from mjsim.errors import InputError
    from simgap.gating import axis, robot
    from simgap.gating.check import read_baseline
    from simgap.robot import is_robot

    known = read_baseline(baseline, against)
    if is_robot(list(recordings), model) != known.robot:
        what = ("an axis", "a robot")
        raise InputError(
            model, f"it is {what[not known.robot]}, and {str(baseline)!r} is the diagnosis of {what[known.robot]}",
            "a baseline of this model", "run simgap diagnose with it",
        )  # fmt: skip
    judge = robot.judged if known.robot else axis.judged
    return judge(model, recordings, known, tolerance)


def _show(checks: Sequence[Check]) -> None:
    from rich.console import Console
    from rich.table import Table

    from simgap.terminal import rich_text

    table = Table("recordings", "in the baseline", "rms error", "baseline", "ratio", "")
    for c in checks:
        names = "\n".join(rich_text(n if c.joint is None else f"{n}: {c.joint}") for n in c.recordings)
        result = "[red]grew[/red]" if c.grew else "[green]ok[/green]"
        now = f"{c.rms:.4g} {c.unit}" if math.isfinite(c.rms) else "diverges"
        table.add_row(names, c.role, now, f"{c.baseline_rms:.4g} {c.unit}", f"{c.ratio:.3f}", result)
    Console().print(table)


def as_markdown(model: Path, checks: Sequence[Check], tolerance: float) -> str:
    """The comparison as Markdown: one sentence, one table."""
    from simgap.terminal import printable

    def cell(text: str) -> str:
        return printable(text).replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;")

    worse = sum(c.grew for c in checks)
    verdict = f"{worse} of {len(checks)} errors grew" if worse else "no error grew"
    lines = [
        f"**simgap gate: {verdict}** by more than {100 * tolerance:g} % (`{cell(model.name)}`).", "",
        "| recording | rms error | baseline | ratio | |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for c in checks:
        names = ", ".join(c.recordings) + ("" if c.joint is None else f": {c.joint}")
        now = f"{c.rms:.4g} {c.unit}" if math.isfinite(c.rms) else "diverges"
        lines.append(
            f"| {cell(names)} | {now} | {c.baseline_rms:.4g} {c.unit} | {c.ratio:.3f} | {'**grew**' if c.grew else 'ok'} |"
        )
    return "\n".join(lines) + "\n"


@click.command("gate", epilog="Example: simgap gate robot.xml log.csv --baseline report/diagnosis.json")
@click.argument("model", type=ModelFile())
@model_root
@click.argument("recordings", nargs=-1, required=True, type=InputFile())
@click.option(
    "--baseline", required=True, type=InputFile(".json", usual="diagnosis.json"), help="diagnosis.json to compare with."
)
@click.option(
    "--against", type=Choice(["nominal", "corrected"]), default="nominal", show_default=True,
    help="Figures of the baseline: those of the model that was diagnosed, or of its corrected.xml.",
)  # fmt: skip
@click.option(
    "--tolerance", type=Amount(min=0), default=0.02, show_default=True,
    help="Allowed growth of the rms error, as a fraction of the baseline's.",
)  # fmt: skip
@click.option("--markdown", type=OutputFile(".md"), help="Write the comparison as Markdown too, such as for a job summary.")
@click.option("--json", "as_json", is_flag=True, help="Print the comparison as JSON.")
def command(
    model: Path, recordings: tuple[Path, ...], baseline: Path, against: str, tolerance: float, markdown: Path | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Fail when MODEL predicts RECORDINGS worse than a baseline: a regression test for a model.

    MuJoCo steps the file, with its own options, on each recording, and the rms error is compared with that of the baseline. The
    error is that of the diagnosis: of the free-run motion, or of the force that the recorded motion needs. Of a robot all joints
    run together and each is compared: its position under its servo, or the torque that holds it to the recording. Exit 1 when
    an error exceeds that of the baseline by more than the tolerance.
    """
    from diagnose.json_file import json_text
    from ident.serial import write_atomic
    from mjsim.errors import CheckError

    if markdown is not None:
        take_file(markdown, "choose another --markdown")
        spare_inputs([markdown], [model, *recordings, baseline], "--markdown")
    checks = judged(model, recordings, baseline, against, tolerance)
    worse = [c for c in checks if c.grew]
    if markdown is not None:
        write_atomic(markdown, as_markdown(model, checks, tolerance))
    if as_json:
        units = {c.unit for c in checks}
        unit = units.pop() if len(units) == 1 else None
        told = {"passed": not worse, "against": against, "tolerance": tolerance, "unit": unit}
        click.echo(json_text(told | {"checks": [asdict(c) for c in checks]}))
    else:
        _show(checks)
    if worse:
        names = ", ".join(dict.fromkeys(f"{n} ({c.joint})" if c.joint else n for c in worse for n in c.recordings))
        most = max(c.ratio for c in worse)
        grown = f"{most:.3f} times the baseline's" if math.isfinite(most) else "not finite: the model diverges"
        raise CheckError(f"the error of {model.name} on {names} is {grown}; allowed: {1 + tolerance:g} times")
