"""The diagnosis of a robot as Markdown: what stands in a pull request beside a change of the model."""

from __future__ import annotations

from pathlib import Path

from diagnose.report.document import write_page
from diagnose.report.figures import estimate, interval, number, p_value, prose, unit
from diagnose.report.summary import markdown_code, markdown_table, markdown_text
from diagnose.report.words import VERDICTS, effect_name
from diagnose.robot.result import JointResult, RobotDiagnosis

__all__ = ["summary", "write_summary"]

MOST_NOTES = 5
MOST_CHANGED = 20


def write_summary(d: RobotDiagnosis, path: Path) -> None:
    """Write the summary in one move."""
    write_page(summary(d), path)


def summary(d: RobotDiagnosis) -> str:
    """Verdict, a table of joints with the errors of the files, findings with intervals, numbers that changed, notes."""
    parts = [f"## {VERDICTS[d.verdict].badge}", markdown_text(prose(d.summary))]
    if d.joints:
        head = [
            "Joint",
            "verdict",
            "unit",
            "held-out error of the file, in MuJoCo",
            "its numbers refitted",
            "corrected.xml, in MuJoCo",
        ]
        parts.append(markdown_table(head, [_joint(name, r) for name, r in d.joints.items()]))
    findings = [row for r in d.joints.values() for row in _findings(r)]
    if findings:
        parts.append(markdown_table(["Missing", "parameter", "value", "95 % interval", "unit", "p, held out"], findings))
    if d.changed:
        parts += ["Numbers of the model that differ:", _listed(d.changed, MOST_CHANGED)]
    if d.notes:
        parts.append(_listed(d.notes, MOST_NOTES))
    files = ", ".join(f"`{markdown_code(r.get('file', ''))}`" for r in d.recordings)
    parts.append(f"<sub>simgap {markdown_text(d.versions.get('simgap', ''))}; recordings: {files or 'none'}.</sub>")
    return "\n\n".join(parts) + "\n"


def _joint(name: str, r: JointResult) -> list[str]:
    errors = [number(r.fit[key].held_out_rms) if key in r.fit else "" for key in ("nominal", "refitted", "corrected")]
    return [name, VERDICTS[r.verdict].badge, unit(r.unit), *errors]


def _findings(r: JointResult) -> list[list[str]]:
    rows = []
    for f in r.findings:
        p = p_value(f.evidence.get("p_value"))
        first = f"{effect_name(f.effect)} at {f.joint}" + (f", from {f.source}" if f.source else "")
        for i, (name, e) in enumerate(f.parameters.items()):
            rows.append([first if i == 0 else "", name, estimate(e), interval(e), unit(e.unit), p if i == 0 else ""])
        if not f.parameters:
            rows.append([first, "", "", "", "", p])
    return rows


def _listed(lines: tuple[str, ...], most: int) -> str:
    more = [f"- and {len(lines) - most} more"] if len(lines) > most else []
    return "\n".join([*(f"- {markdown_text(prose(line))}" for line in lines[:most]), *more])
