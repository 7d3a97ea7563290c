"""The page of a fleet: which robot lacks what, what drifts, which robots are unlike the others, what to record again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from diagnose.report.components import data_table, theme_button
from diagnose.report.document import document
from diagnose.report.document import write_page as write_text
from diagnose.report.figures import unit
from diagnose.report.words import effect_name
from simgap.fleet.trends import AGAIN, Drift, Outlier, drifts, outliers, to_record_again

__all__ = ["counted", "headline", "write_page"]

_STYLE = """
.spark { width: 9rem; height: 2.2rem; vertical-align: middle; } .spark circle { fill: var(--corrected); }
.spark polyline { fill: none; stroke: var(--corrected); stroke-width: 1.5; }
"""


def counted(count: int, noun: str) -> str:
    """``1 robot``, ``2 robots``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def headline(table: Sequence[Mapping[str, Any]]) -> str:
    """How many recordings have which verdict, in words."""
    verdicts: dict[str, set[str]] = defaultdict(set)
    for r in table:
        verdicts[r["verdict"]].add(r["key"])
    return ", ".join(
        f"{len(keys)} {verdict.replace('_', ' ')}" for verdict, keys in sorted(verdicts.items(), key=lambda x: -len(x[1]))
    )


def write_page(path: Path, table: Sequence[Mapping[str, Any]], model: str) -> None:
    """Write the page in one move. Every text from a file is escaped."""
    robots: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for r in table:
        robots[r["robot"]].append(r)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["counted"] = counted
    logs = len({r["key"] for r in table})
    body = environment.get_template("page.html.j2").render(
        robots=robots, logs=logs, headline=headline(table), model=model, matrix=_matrix(robots),
        drifts=_drifts(drifts(table)), outliers=_outliers(outliers(table)), again=_again(table), theme_button=theme_button,
    )  # fmt: skip
    write_text(document(f"Fleet: {counted(len(robots), 'robot')}, {counted(logs, 'recording')}", body, style=_STYLE), path)


def _matrix(robots: Mapping[str, Sequence[Mapping[str, Any]]]) -> Markup:
    """Robots by effects."""
    effects = sorted({_name(r) for rows in robots.values() for r in rows if r["effect"]})
    heads = ("Robot", "Recordings", *effects, "Nothing missing", "No answer")
    return data_table(
        heads, [_row(name, rows, effects) for name, rows in sorted(robots.items())], numeric=range(1, len(effects) + 4)
    )


def _drifts(found: Sequence[Drift]) -> Markup | None:
    heads = ("Robot", "Effect", "Parameter", "Change a day (95 %)", "Over time")
    rows = [
        (d.robot, _at(d.effect, d.joint), d.parameter, f"{d.per_day:.3g} {unit(d.unit)} ({d.low:.3g} to {d.high:.3g})", _spark(d))
        for d in found
    ]
    return data_table(heads, rows, numeric=(3,)) if rows else None


def _outliers(found: Sequence[Outlier]) -> Markup | None:
    heads = ("Robot", "Effect", "Parameter", "Value", "Median of the fleet")
    rows = [
        (o.robot, _at(o.effect, o.joint), o.parameter, f"{o.value:.4g} {unit(o.unit)}", f"{o.median:.4g} {unit(o.unit)}")
        for o in found
    ]
    return data_table(heads, rows, numeric=(3, 4)) if rows else None


def _again(table: Sequence[Mapping[str, Any]]) -> Markup | None:
    heads = ("Robot", "Recording", "Verdict", "What to do")
    rows = [(robot, log, verdict.replace("_", " "), todo or "") for robot, log, verdict, todo in to_record_again(table)]
    return data_table(heads, rows, wide=(1, 3)) if rows else None


def _at(effect: str, joint: str | None) -> str:
    return f"{effect_name(effect)} at {joint}" if joint else effect_name(effect)


def _name(row: Mapping[str, Any]) -> str:
    return _at(str(row["effect"]), row["joint"])


def _row(name: str, rows: Sequence[Mapping[str, Any]], effects: Sequence[str]) -> list[str]:
    """Recordings, share and median of each effect, and how many recordings lack nothing or gave no answer."""
    logs = {r["key"] for r in rows}
    cells = []
    for effect in effects:
        own = [r for r in rows if r["effect"] and _name(r) == effect]
        first = own[0]["parameter"] if own else ""
        values = [r["value"] for r in own if r["parameter"] == first]
        share = len({r["key"] for r in own}) / len(logs)
        cells.append(f"{100 * share:.0f} %, {np.median(values):.3g} {unit(own[0]['unit'] or '')}" if own else "")
    fine = {r["key"] for r in rows if r["verdict"] in ("no_mismatch", "parameters_only")}
    again = {r["key"] for r in rows if r["verdict"] in AGAIN}
    return [name, str(len(logs)), *cells, str(len(fine)), str(len(again))]


def _spark(drift: Drift) -> Markup:
    """A small plot of a drifting parameter."""
    x, y = np.array(drift.days), np.array(drift.values)
    px = 4 + 112 * (x - x[0]) / max(float(np.ptp(x)), 1e-12)
    py = 26 - 22 * (y - y.min()) / max(float(np.ptp(y)), 1e-300)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True))
    dots = "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2"/>' for a, b in zip(px, py, strict=True))
    label = f"{len(x)} values over {x[-1]:.3g} days, from {y[0]:.3g} to {y[-1]:.3g}"
    return Markup(
        f'<svg class="spark" viewBox="0 0 120 30" role="img" aria-label="{label}"><polyline points="{points}"/>{dots}</svg>'
    )
