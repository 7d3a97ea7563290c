"""A diagnosis as Markdown: what stands in a pull request beside a change of the model."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from diagnose.report.charts import NAMES
from diagnose.report.document import write_page
from diagnose.report.figures import estimate, interval, number, p_value, percent, prose, unit
from diagnose.report.tables import weak
from diagnose.report.words import VERDICTS, effect_name, linear_name
from diagnose.result import Diagnosis, Estimate

__all__ = ["markdown_code", "markdown_table", "markdown_text", "summary", "write_summary"]

_MOST_NOTES = 5


def write_summary(d: Diagnosis, path: Path) -> None:
    """Write the summary in one move."""
    write_page(summary(d), path)


def summary(d: Diagnosis) -> str:
    """Verdict, errors of the files, findings with intervals, numbers that changed, notes, what to measure next."""
    parts = [f"## {VERDICTS[d.verdict].badge}", markdown_text(prose(d.summary))]
    if d.fit:
        parts.append(_errors(d))
    if d.findings:
        parts.append(_findings(d))
    changed = _changed(d)
    if changed:
        parts += ["Numbers of the model that differ:", changed]
    if d.notes:
        more = [f"- and {len(d.notes) - _MOST_NOTES} more"] if len(d.notes) > _MOST_NOTES else []
        parts.append("\n".join([*(f"- {markdown_text(prose(n))}" for n in d.notes[:_MOST_NOTES]), *more]))
    if d.next_experiment:
        parts.append(f"**Next:** {markdown_text(prose(d.next_experiment))}")
    files = ", ".join(dict.fromkeys(f"`{markdown_code(r.get('file', ''))}`" for r in d.recordings))
    parts.append(f"<sub>simgap {markdown_text(d.versions.get('simgap', ''))}; recordings: {files or 'none'}.</sub>")
    return "\n\n".join(parts) + "\n"


def _errors(d: Diagnosis) -> str:
    u = unit(d.unit)
    rows = [
        (NAMES[key] + (", in plain MuJoCo" if d.surrogate and key != "refitted" else ""), number(f.rms), number(f.held_out_rms))
        for key, f in d.fit.items()
        if key in NAMES
    ]
    if d.noise_floor > 0:
        rows.append(("noise", "", number(d.noise_floor)))
    return markdown_table([f"Error in {d.channel}, rms [{u}]", "estimation", "held out"], rows)


def _findings(d: Diagnosis) -> str:
    rows = []
    for f in d.findings:
        p = p_value(f.evidence.get("p_value"))
        first = f"{effect_name(f.effect)}, {f.place} ({f.element})"
        for i, (name, e) in enumerate(f.parameters.items() or [("", None)]):
            told = (
                ("", "", "")
                if e is None
                else (estimate(e) + (" (not told from zero)" if weak(e) else ""), interval(e), unit(e.unit))
            )
            rows.append((first if i == 0 else "", name, *told, p if i == 0 else ""))
    return markdown_table(["Missing", "parameter", "value", "95 % interval", "unit", "p, held out"], rows)


def _changed(d: Diagnosis) -> str:
    def outside(nominal: float | None, e: Estimate) -> bool:
        return nominal is not None and not e.ci95[0] <= nominal <= e.ci95[1]

    rows = [
        (f"{name} ({linear_name(name, e.unit)})", number(d.nominal_parameters[name]), estimate(e), interval(e), unit(e.unit),
         percent((e.value - d.nominal_parameters[name]) / abs(d.nominal_parameters[name])) if d.nominal_parameters[name] else "")
        for name, e in d.linear_parameters.items()
        if outside(d.nominal_parameters.get(name), e)
    ]  # fmt: skip
    return markdown_table(["Number", "file", "identified", "95 % interval", "unit", "change"], rows) if rows else ""


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose cells are text, without markup."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell if cell == "---" else markdown_text(cell) for cell in line) + " |" for line in lines)


def markdown_text(text: str) -> str:
    """Text in which nothing is markup: of Markdown, of HTML or of a table."""
    return re.sub(r"([\\`*_\[\]<>|#~])", r"\\\1", re.sub(r"\s*\n\s*", " ", text)).replace("&", "&amp;")


def markdown_code(text: str) -> str:
    """Text within backquotes."""
    return re.sub(r"[`\n|]", " ", text)
