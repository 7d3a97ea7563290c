"""The page of a fleet: which robot lacks what, what drifts, which robots are unlike the others, what to record again."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from simgap.fleet.trends import AGAIN, Drift, drifts, outliers, to_record_again

__all__ = ["headline", "write_page"]


@dataclass(frozen=True)
class RobotRow:
    """One line of the matrix: cells in the order of the effects; how many recordings lack nothing, how many gave no answer."""

    name: str
    logs: int
    cells: tuple[str, ...]
    fine: int
    open: int


def headline(table: Sequence[Mapping[str, Any]]) -> str:
    """How many recordings have which verdict, in words."""
    verdicts: dict[str, set[str]] = defaultdict(set)
    for r in table:
        verdicts[r["verdict"]].add(r["key"])
    return ", ".join(
        f"{len(keys)} {verdict.replace('_', ' ')}" for verdict, keys in sorted(verdicts.items(), key=lambda x: -len(x[1]))
    )


def write_page(path: Path, table: Sequence[Mapping[str, Any]], model: str) -> None:
    """Write the page, beside the final name first. Every text from a file is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=jinja2.StrictUndefined
    )
    effects = sorted({_name(r) for r in table if r["effect"]})
    text = environment.get_template("page.html.j2").render(
        robots=_robots(table, effects), logs=len({r["key"] for r in table}), headline=headline(table), effects=effects,
        drifts=drifts(table), outliers=outliers(table), again=to_record_again(table), model=model, spark=_spark,
    )  # fmt: skip
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _name(row: Mapping[str, Any]) -> str:
    return f"{row['effect']} at {row['joint']}" if row["joint"] else str(row["effect"])


def _robots(table: Sequence[Mapping[str, Any]], effects: Sequence[str]) -> list[RobotRow]:
    by: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for r in table:
        by[r["robot"]].append(r)
    return [_row(name, rows, effects) for name, rows in sorted(by.items())]


def _row(name: str, rows: Sequence[Mapping[str, Any]], effects: Sequence[str]) -> RobotRow:
    logs = {r["key"] for r in rows}
    cells = []
    for effect in effects:
        own = [r for r in rows if r["effect"] and _name(r) == effect]
        first = own[0]["parameter"] if own else ""
        values = [r["value"] for r in own if r["parameter"] == first]
        share = len({r["key"] for r in own}) / len(logs)
        cells.append(f"{100 * share:.0f} %, {np.median(values):.3g} {own[0]['unit'] or ''}" if own else "")
    fine = {r["key"] for r in rows if r["verdict"] in ("no_mismatch", "parameters_only")}
    again = {r["key"] for r in rows if r["verdict"] in AGAIN}
    return RobotRow(name, len(logs), tuple(cells), len(fine), len(again))


def _spark(drift: Drift) -> Markup:
    """A small plot of a drifting parameter."""
    x, y = np.array(drift.days), np.array(drift.values)
    px = 4 + 112 * (x - x[0]) / max(float(np.ptp(x)), 1e-12)
    py = 26 - 22 * (y - y.min()) / max(float(np.ptp(y)), 1e-300)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True))
    dots = "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2"/>' for a, b in zip(px, py, strict=True))
    label = f"{len(x)} values over {x[-1]:.3g} days, from {y[0]:.3g} to {y[-1]:.3g}"
    return Markup(f'<svg viewBox="0 0 120 30" role="img" aria-label="{label}"><polyline points="{points}"/>{dots}</svg>')
