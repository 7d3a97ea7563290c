"""``simgap demo``: diagnose a simulated axis with a hidden effect and compare the findings with the truth."""

from __future__ import annotations

from pathlib import Path

import click

from simgap.arguments import OutputFolder, take_folder

__all__ = ["command"]


@click.command("demo", epilog="Example: simgap demo --seed 7 --out out/demo")
@click.option("--out", default=Path("out/demo"), show_default=True, type=OutputFolder(), help="Folder for the results.")
@click.option(
    "--seed", default=1, show_default=True, type=click.IntRange(0), help="Seed of the effect, its size, the axis and the noise."
)
@click.option(
    "--level",
    default="plain",
    show_default=True,
    help="Kind of case, as simgap benchmark names them (plain, pair, nothing, ...).",
)
@click.option("--jobs", default=2, show_default=True, type=click.IntRange(1), help="Threads.")
@click.option("--json", "as_json", is_flag=True, help="Print the truth and the diagnosis as JSON.")
def command(out: Path, seed: int, level: str, jobs: int, as_json: bool) -> None:
    """Simulate the ABB IRB1400 axis with a random hidden effect, diagnose it, and print the truth beside the findings.

    The recordings come from a simulator with its own laws and its own solver. The diagnosis gets the CSV files and the
    nominal model, nothing else. The truth is in a file whose SHA-256 is printed before the diagnosis begins.
    """
    from diagnose.json_file import json_text
    from diagnose.pipeline import Options
    from lab.benchmark.seal import open_envelope, write_cases
    from mjsim.models import shipped_model
    from simgap.pipeline import diagnose_files, model_diff
    from simgap.show import show_diagnosis

    take_folder(out)
    recordings, truth_file = out / "recordings", out / "envelope" / "truth.json"
    digest = write_cases(recordings, truth_file, {level: 1}, seed)
    if not as_json:
        click.echo(
            f"{recordings / '001_estimation.csv'} holds a hidden effect; the file with the truth has the SHA-256 {digest[:16]}..."
        )
    model = shipped_model("robot_axis1")
    inputs = [recordings / "001_estimation.csv"], model, out, [recordings / "001_held_out.csv"]
    options = Options(jobs=jobs, seed=seed)
    result = diagnose_files(*inputs, options, progress=not as_json)
    truth = open_envelope(recordings, truth_file)["001"]
    if as_json:
        click.echo(json_text({"truth": truth, "diagnosis": result.as_dict()}))
        return
    show_diagnosis(result, out)
    show_truth(truth, result.findings)
    from diagnose.report import write_report

    diff = model_diff(model, out / "corrected.xml")
    write_report(result, out / "report.html", corrected_diff=diff, truth=truth)


def show_truth(truth, findings) -> None:  # type: ignore[no-untyped-def]
    """Print the truth beside the findings."""
    from rich.console import Console
    from rich.table import Table

    table = Table("true effect", "parameter", "truth", "found", "95 % interval")
    found = {f.effect: f for f in findings}
    for effect in truth["effects"] or ["(nothing)"]:
        if effect not in truth["parameters"]:
            table.add_row(effect, "", "", ", ".join(found) or "(nothing)", "")
            continue
        for name, value in truth["parameters"][effect].items():
            f = found.get(effect)
            e = f.parameters.get(name) if f else None
            interval = f"[{e.ci95[0]:.4g}, {e.ci95[1]:.4g}]" if e else ""
            shown = f"{e.value:.4g}" if e else ", ".join(found) or "(nothing)"
            given = f"{value:.4g}" if isinstance(value, float) else str(value)
            table.add_row(f"{effect} at {truth['where'].get(effect, '')}", name, given, shown, interval)
    Console().print(table)
