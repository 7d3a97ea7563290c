"""The report of a robot: one self-contained page with a matrix of joints and effects, and a section a joint."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from markupsafe import Markup

from diagnose.report.charts import COLOURS, NAMES, recording_chart
from diagnose.report.components import Column, explorer_section, table, theme_button
from diagnose.report.document import document
from diagnose.report.document import write_page as write_text
from diagnose.report.figures import estimate, interval, number, p_value, percent, prose, unit
from diagnose.report.film import Film, film_figure
from diagnose.report.plots import Explorer, Signals, page_data
from diagnose.report.words import VERDICTS, effect_name
from diagnose.result import Estimate, FitFigures
from diagnose.robot.result import JointResult, RobotDiagnosis, RobotFinding, Trace

__all__ = ["explorer_of", "render_page", "write_page"]

MODELS = {
    "nominal": "file as given, in MuJoCo",
    "refitted": "its numbers refitted",
    "corrected": "corrected.xml, in MuJoCo",
    "surrogate": "with all findings, by the fitting engine",
}


def write_page(d: RobotDiagnosis, path: Path, film: Film | str | None = None) -> None:
    """Write the page in one move; nothing half-written is left under ``path``. ``film``: of the robot, or why there is none."""
    write_text(render_page(d, film), path)


def render_page(d: RobotDiagnosis, film: Film | str | None = None) -> str:
    """The page as text."""
    words = VERDICTS[d.verdict]
    names = ", ".join(escape(r["file"]) for r in d.recordings)
    explorers = {r.joint: explorer_of(r, i) for i, r in enumerate(d.joints.values())}
    body = [
        "<header>", f'<p class="kicker">Diagnosis of {names}, every joint judged on {_judged(d)}</p>', theme_button(),
        f'<p class="verdict"><span class="badge {words.colour}">{words.badge}</span></p>', f"<h1>{escape(prose(d.summary))}</h1>",
        f'<p class="meaning">{escape(words.meaning)}</p>',
        '<nav aria-label="Contents">' + "".join(f'<a href="#{escape(j)}">{escape(j)}</a>' for j in d.joints) + "</nav>", "</header>", '<main id="content">',
        d.picture, str(film_figure(film)) if film is not None else "", _matrix(d), _errors(d), _recordings(d), _changed(d), *(_joint(r, explorers[r.joint]) for r in d.joints.values()), _links(d), _notes(d), "</main>", _footer(d),
    ]  # fmt: skip
    shown = [e for e in explorers.values() if e is not None]
    return document(f"{words.badge}: diagnosis of a robot", "\n".join(body), page_data([], shown) if shown else None)


def _judged(d: RobotDiagnosis) -> str:
    return "its position under the recorded commands" if d.judged_on["channel"] == "angle" else "the torque that its motion needs"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[int] = ()) -> str:
    """A table; heads and cells are HTML already; the first of a row heads it."""
    columns = [Column(Markup(h), numeric=i in numeric) for i, h in enumerate(head)]
    return str(
        table(columns, [[Markup(cell) for cell in row] for row in rows])
    )  # text: Markup would escape what is put before it


def _badge(r: JointResult) -> str:
    words = VERDICTS[r.verdict]
    return f'<span class="badge tiny {words.colour}">{words.badge}</span>'


def _matrix(d: RobotDiagnosis) -> str:
    """Joints by effects: what is missing where, with its first parameter."""
    effects = list(dict.fromkeys(f.effect for f in d.findings))
    rows = []
    for joint, r in d.joints.items():
        found = {f.effect: f for f in r.findings}
        cells = [_size(found[e]) if e in found else '<span class="muted">·</span>' for e in effects]
        rows.append([f'<a href="#{escape(joint)}">{escape(joint)}</a>', _badge(r), *cells])
    return '<section id="matrix" class="firm"><h2>What is missing where</h2>' + _table(
        ["Joint", "Verdict", *(escape(effect_name(e)) for e in effects)], rows
    ) + "</section>"  # fmt: skip


def _size(f: RobotFinding) -> str:
    name, e = next(iter(f.parameters.items()))
    return (
        f"<strong>{estimate(e)}</strong> {unit(e.unit)}"
        if name != "delay_s"
        else f"<strong>{number(1e3 * e.value, 3)}</strong> ms"
    )


def _errors(d: RobotDiagnosis) -> str:
    rows = [
        [escape(joint), *(f"{percent(f.held_out_nrmse, 3)}" for f in r.fit.values()), percent(max(r.remains[0], 0.0))]
        for joint, r in d.joints.items()
    ]
    head = ["Joint", *(MODELS.get(k, k) for k in next(iter(d.joints.values())).fit), "Still predictable, of the squared error"]
    if d.judged_on["channel"] == "angle":
        said = (
            "All joints together in MuJoCo on the recorded commands: root mean square over the spread of the measured position."
        )
        table = _table(head, rows, range(1, len(head)))
        return f'<section id="errors" class="firm"><h2>Error of the position, held out</h2><p>{said}</p>{table}</section>'
    return (
        "<section id=\"errors\" class=\"firm\"><h2>Error of the torque, held out</h2><p>Root mean square over the spread of the measured torque. "
        "The noise of a torque is not known beforehand: the last column says how much of the residual a black-box model predicts.</p>"
        + _table(head, rows, range(1, len(head))) + "</section>"
    )  # fmt: skip


def _changed(d: RobotDiagnosis) -> str:
    if not d.changed:
        return ""
    items = "".join(f"<li>{escape(prose(line))}</li>" for line in d.changed)
    return f'<section id="changed"><h2>Numbers of the file that differ</h2><p>The fewest groups of numbers that have to change:</p><ul>{items}</ul></section>'


def _joint(r: JointResult, explorer: Explorer | None) -> str:
    parts = [f'<section id="{escape(r.joint)}"><h2>{escape(r.joint)} {_badge(r)}</h2>', f"<p>{escape(prose(r.summary))}</p>"]
    parts += [_finding(f, r.unit) for f in r.findings]
    parts.append(_figure(r, explorer))
    rows = [[escape(MODELS.get(k, k)), *_four(f)] for k, f in r.fit.items()]
    u = unit(r.unit)
    parts.append(
        _table(
            ["Model", f"fitted [{u}]", "fitted, over the spread", f"held out [{u}]", "held out, over the spread"],
            rows,
            (1, 2, 3, 4),
        )
    )
    own = [[escape(k), number(r.nominal_parameters.get(k)), *_estimated(e)] for k, e in r.linear_parameters.items()]
    parts.append(_table(["Own number", "file", "fitted", "95 % interval", "unit"], own, (1, 2, 3)))
    if r.refusals:
        items = "".join(f"<li>{escape(effect_name(line))}</li>" for line in r.refusals[:12])
        parts.append(f"<details><summary>What was tried and refused</summary><ul>{items}</ul></details>")
    return "\n".join(parts) + "</section>"


def _four(f: FitFigures) -> list[str]:
    return [number(f.rms), percent(f.nrmse, 3), number(f.held_out_rms), percent(f.held_out_nrmse, 3)]


def _estimated(e: Estimate) -> list[str]:
    return [estimate(e), interval(e), unit(e.unit)]


def _finding(f: RobotFinding, channel: str) -> str:
    rows = [[escape(name), *_estimated(e)] for name, e in f.parameters.items()]
    e, u = f.evidence, unit(channel)
    told = (
        f"Held out, the {'position' if channel in ('rad', 'm') else 'torque'} is missed by {number(e['held_out_error_before'])} {u} rms without it and by "
        f"{number(e['held_out_error_after'])} {u} with it. Probability of such a gain by chance: {p_value(e['p_value'])}, corrected for "
        "all joints and laws."
    )
    alike = f"<p>Cannot be told from: {escape(', '.join(effect_name(x) for x in f.equivalents))}.</p>" if f.equivalents else ""
    origin = f" (from {escape(f.source)})" if f.source else ""
    return (
        f'<div class="finding"><h3>{escape(effect_name(f.effect))}{origin}</h3><p>{escape(f.sentence)}</p>'
        + _table(["Parameter", "value", "95 % interval", "unit"], rows, (1, 2)) + f"<p>{told}</p>{alike}</div>"
    )  # fmt: skip


def explorer_of(r: JointResult, index: int) -> Explorer | None:
    """Recordings of a joint beside the models; None where nothing was compared. ``index``: of the joint on the page."""
    traces = sorted((t for t in r.traces if len(t.time) > 1), key=lambda t: t.role != "estimation")
    if not traces:
        return None
    recordings = tuple(_signals(t, added=bool(r.findings)) for t in traces)
    channel, u = _channel(r), unit(r.unit)
    error_of = "refitted" if r.findings else "corrected"
    held = [s for s in recordings if s.role == "held-out"]
    printed = max(held or recordings, key=lambda s: len(s.time))
    static = (recording_chart(printed, channel, u, error_of, f"joint-{index}-printed"),)
    return Explorer(f"joint-{index}", channel, u, recordings, NAMES, COLOURS, error_of, static)


def _signals(t: Trace, *, added: bool) -> Signals:
    """A trace for the explorer; where nothing was added, the corrected model is the refitted one."""
    models = {"nominal": t.nominal, **({"refitted": t.refitted} if added else {}), "corrected": t.corrected}
    return Signals(t.source, t.role, t.time, t.measured, models, t.states, t.counted)


def _figure(r: JointResult, explorer: Explorer | None) -> str:
    """The explorer of a joint."""
    if explorer is None:
        return ""
    said = "one joint at a time, the others following the recording" if _channel(r) == "position" else "by inverse dynamics"
    return f"<p>{_channel(r).capitalize()}, measured and by the models, {said}.</p>" + str(
        explorer_section(explorer, f"Recordings of {r.joint}")
    )


def _channel(r: JointResult) -> str:
    return "position" if r.unit in ("rad", "m") else "torque"


def _recordings(d: RobotDiagnosis) -> str:
    """Errors of both files by joint and recording, all joints together in MuJoCo."""
    if d.closed_loop is None or "joints" not in d.closed_loop:
        return ""
    rows, torque = [], d.closed_loop.get("unit") == "torque"
    scale, u = (1.0, "N m") if torque else (1e3, "1e-3")
    for joint, table_ in d.closed_loop["joints"].items():
        for row in table_:
            if row["moves"]:
                errors = [
                    number(scale * row[k], 3) if row[k] is not None else "diverged" for k in ("nominal_rms", "corrected_rms")
                ]
                rows.append([escape(joint), escape(row["file"]), row["role"], *errors])
    lacking = d.closed_loop.get("lacking") or []
    said = f"{escape(d.closed_loop['engine'])}." + (f" Not run: {escape(', '.join(lacking))}." if lacking else "")
    head = ["Joint", "Recording", "Role", f"file as given [{u}]", f"corrected.xml [{u}]"]
    inner = _table(head, rows, (3, 4))
    return (
        f'<section id="closed-loop"><h2>All joints together</h2><p>{said}</p><details><summary>{len(rows)} errors by joint and '
        f"recording, root mean square</summary>{inner}</details></section>"
    )


def _links(d: RobotDiagnosis) -> str:
    if not d.links:
        return ""
    rows = [[escape(k), number(d.nominal_links.get(k)), *_estimated(e)] for k, e in d.links.items()]
    base = [[escape(b.combination), number(b.nominal), *_estimated(b.estimate)] for b in d.base]
    head = ["file", "fitted", "95 % interval", "unit"]
    return (
        '<section id="links"><h2>Inertial parameters</h2><p>What the motion determines are combinations of the links\' parameters; of a single one '
        f"an interval as wide as the prior says that it is not told apart.{_rank(d)}</p>"
        + f"<details><summary>{len(base)} combinations that are determined</summary>" + _table(["Combination", *head], base, (1, 2, 3)) + "</details>"
        + "<details><summary>Every link</summary>" + _table(["Parameter", *head], rows, (1, 2, 3)) + "</details></section>"
    )  # fmt: skip


def _rank(d: RobotDiagnosis) -> str:
    c = d.conditioning
    return f" The data tell {c.rank} of {c.numbers} numbers apart." if c is not None else ""


def _notes(d: RobotDiagnosis) -> str:
    if not d.notes:
        return ""
    return (
        '<section id="limits"><h2>What it cannot tell</h2><ul>'
        + "".join(f"<li>{escape(n)}</li>" for n in d.notes)
        + "</ul></section>"
    )


def _footer(d: RobotDiagnosis) -> str:
    rows = "".join(f"<li>{escape(r['file'])} ({escape(r['role'])}) <code>{escape(r['sha256'])}</code></li>" for r in d.recordings)
    versions = ", ".join(f"{k} {v}" for k, v in d.versions.items())
    below = f"Below {number(d.cutoff_hz, 3)} Hz; " if np.isfinite(d.cutoff_hz) else ""
    return (
        f"<footer><h2>Provenance</h2><ul>{rows}</ul><p>{below}{d.hypotheses} hypotheses; {number(d.seconds, 3)} s; "
        f"{escape(versions)}.</p></footer>"
    )
