"""A diagnosis, or a check of a log, on the terminal."""

from __future__ import annotations

import math
from pathlib import Path

from diagnose.check.types import LogCheck, Severity
from diagnose.result import Diagnosis, Estimate, FitFigures
from diagnose.robot.result import RobotDiagnosis
from simgap.api.diagnosing import Diagnosis as Found
from simgap.terminal import rich_text

__all__ = ["estimate_text", "show_check", "show_diagnosis", "show_found", "show_robot"]


def show_found(found: Found, out: Path) -> None:
    """The outcome of `simgap.diagnose`, of an axis or of a robot."""
    if isinstance(found.result, RobotDiagnosis):
        show_robot(found.result, out)
    else:
        show_diagnosis(found.result, out)


def show_robot(result: RobotDiagnosis, out: Path) -> None:
    """Verdict, what is missing with its numbers, and a table of joints with the errors of the models."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(highlight=False)
    console.print(f"[bold]{result.verdict.value}[/bold]  {escape(result.summary)}")
    for f in (f for r in result.joints.values() for f in r.findings):
        console.print(f"\n[bold]{escape(f.effect)}[/bold] at {escape(f.joint)}\n  {escape(f.sentence)}")
        for k, e in f.parameters.items():
            console.print(f"  {escape(k)} = {escape(estimate_text(e))}")
        if f.equivalents:
            console.print(f"  cannot be told from: {escape(', '.join(f.equivalents))}")
    table = Table("joint", "verdict", "file", "refitted", "corrected", "still predictable", title="Held-out error")
    for name, r in result.joints.items():
        errors = [_held_out(r.fit[k], r.unit) for k in ("nominal", "refitted", "corrected")]
        table.add_row(escape(name), r.verdict.value, *errors, f"{100 * max(r.remains[0], 0.0):.1f} %")
    console.print(table)
    for note in result.notes:
        console.print(escape(note))
    console.print(f"Report: {escape(str(out / 'report.html'))}   ({result.seconds:.0f} s)")


def show_diagnosis(result: Diagnosis, out: Path) -> None:
    """Verdict, findings with their numbers, errors before and after, where to read on."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    console.print(f"[bold]{result.verdict.value}[/bold]  {escape(result.summary)}", highlight=False)
    for p in result.log.problems if result.log is not None else ():
        console.print(
            f"log ({p.severity.value}): {p.problem} of the {p.channel} in {p.recording}: {p.advice}",
            highlight=False,
            markup=False,
        )
    for f in result.findings:
        console.print(f"\n[bold]{f.effect}[/bold] at {f.place} (element {escape(f.element)})\n  {f.sentence}", highlight=False)
        for name, e in f.parameters.items():
            console.print(f"  {name} = {escape(estimate_text(e))}", highlight=False)
        ev = f.evidence
        console.print(
            f"  held-out error {ev['held_out_error_before']:.4g} -> {ev['held_out_error_after']:.4g} {result.unit}, "
            f"p = {ev['p_value']:.2g} over {ev['hypotheses']:.0f} hypotheses",
            highlight=False,
        )
        if f.equivalents:
            console.print(f"  cannot be told from: {', '.join(f.rivals)}")
    unit = escape(f"[{result.unit}]")
    table = Table("model", f"rms {unit}", "nrmse", f"held-out rms {unit}", "held-out nrmse")
    for name, fit in result.fit.items():
        table.add_row(name, *(f"{x:.4g}" for x in (fit.rms, fit.nrmse, fit.held_out_rms, fit.held_out_nrmse)))
    if result.noise_floor == result.noise_floor:
        table.add_row("noise floor", f"{result.noise_floor:.4g}", "", "", "")
    console.print(table)
    if a := result.false_alarm:
        console.print(
            f"Of {a['recordings']:.0f} simulated recordings with nothing missing, {a['alarms']:.0f} gave a false alarm "
            f"(95 %: {100 * a['low']:.2g} to {100 * a['high']:.2g} %).",
            highlight=False,
        )
    if result.next_experiment:
        console.print(f"Next: {result.next_experiment}")
    console.print(f"Report: {out / 'report.html'}   ({result.seconds:.0f} s)")


def estimate_text(e: Estimate) -> str:
    """Value, unit and 95 % interval, to two digits of the interval's half-width, at least five and at most ten."""
    half = (e.ci95[1] - e.ci95[0]) / 2
    size = max(map(abs, (e.value, *e.ci95)))
    digits = 5
    if 0 < half < size < math.inf:
        digits = min(10, max(5, 2 + math.floor(math.log10(size)) - math.floor(math.log10(half))))
    return f"{e.value:.{digits}g} {e.unit}   95 % [{e.ci95[0]:.{digits}g}, {e.ci95[1]:.{digits}g}]"


def _held_out(figures: FitFigures, unit: str) -> str:
    """Held-out error: of a position in thousandths, of a torque over its spread."""
    if unit in ("rad", "m"):
        return f"{1e3 * figures.held_out_rms:.2f} m{unit}"
    return f"{100 * figures.held_out_nrmse:.2f} %"


def show_check(check: LogCheck) -> None:
    """What was understood, each problem with what to do, what the excitation shows, and the verdict."""
    from rich.console import Console

    console = Console(highlight=False)
    console.print("[bold]Understood[/bold]")
    for topic, text in check.understood.items():
        console.print(f"  {rich_text(topic)}: {rich_text(text)}")
    if check.excitation:
        console.print("[bold]Excitation[/bold]")
    for e in check.excitation:
        console.print(f"  {rich_text(e.family)}: {'yes' if e.identifiable else 'no'}, {rich_text(e.sentence)}")
    if check.problems:
        console.print("[bold]Problems[/bold]")
    for p in check.problems:
        word = "fix first" if p.severity is Severity.FIX else "limits"
        console.print(f"  {word}: {rich_text(p.recording)}: {p.problem} ({rich_text(p.channel)}): {rich_text(p.sentence)}")
        console.print(f"    do: {rich_text(p.advice)}")
    console.print(f"[bold]{check.verdict.value}[/bold]  {rich_text(check.sentence)}")
