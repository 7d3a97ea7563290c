"""The ledger's page, in HTML beside the figures and in Markdown for the documentation, from one context."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

from diagnose.report.components import data_table, theme_button
from diagnose.report.document import document
from lab.study.claims import AGREED, THRESHOLDS, Verdict, physical_features
from lab.study.ledger import FAMILIES, say
from lab.study.plants import FEATURE_NAMES, PLANTS

if TYPE_CHECKING:
    from lab.study.cell import Feature, Result
    from lab.study.ledger import Entry
    from lab.study.study import Study

__all__ = ["page_html", "page_markdown"]

_STYLE = ".marks { font-family: ui-monospace, Consolas, monospace; letter-spacing: .06em; overflow-wrap: anywhere; }\n"


@cache
def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("lab.study", "."), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        autoescape=lambda name: bool(name and ".html" in name), extensions=["jinja2.ext.do"],
    )  # fmt: skip
    environment.filters["hz"] = _median
    return environment


def _median(values: list[float | None]) -> str:
    """Median and range of what was found [Hz], and how often nothing was."""
    there = sorted(v for v in values if v is not None)
    if not there:
        return "none"
    text = f"{there[len(there) // 2]:.2f}"
    if there[-1] - there[0] >= 0.01:
        text += f" ({there[0]:.2f} to {there[-1]:.2f})"
    return text if len(there) == len(values) else f"{text}, none in {len(values) - len(there)} of {len(values)}"


def _cell(found: Feature | None) -> str:
    return "–" if found is None else f"{found.hz:.2f}"


def _fourth(study: Study) -> list[tuple[str, list[str], str]]:
    """Rows of figure 4's table."""
    rows = []
    for x, family in zip(study.robot_results, FAMILIES.values(), strict=True):
        for who, r in (("robot", x.robot), ("model", x.model)):
            rows.append((f"{who}, {family}", _four(r), "–" if r.void else f"{r.simulation_percent:.1f}"))
    return rows


def _four(r: Result) -> list[str]:
    return ["–"] * 4 if r.void else [_cell(r.features.get(n)) for n in FEATURE_NAMES]


def _row(plant: str, report: Result, better: Result) -> dict[str, Any]:
    label = PLANTS[plant].label.replace("$d_g = +62$", "dg = +62")
    out: dict[str, Any] = {"label": label}
    for family, r in (("report", report), ("better", better)):
        out[family] = _four(r)
        out[f"{family}_fit"] = "–" if r.void else f"{r.simulation_percent:.1f}"
        out[f"{family}_low"] = "–" if r.void else f"{r.low_db:.1f}"
    return out


def _context(study: Study, pictures: str) -> dict[str, Any]:
    exact = physical_features()
    entries = []
    for e, c in zip(study.entries, study.claims, strict=True):
        marks = {
            f: "".join({True: "■", False: "□", None: "·"}[o.met] for v, o in e.answers.items() if v.family == f) for f in FAMILIES
        }
        entries.append(
            {
                "id": e.claim.id,
                "text": e.claim.text,
                "criterion": e.claim.criterion,
                "verdict": e.verdict.value,
                "basis": e.sentence(),
                "marks": marks,
                "readings": [(part.replace("_", " "), r.value) for part, r in e.readings.items()],
                "artefact": e.artefact,
                "other": _other(e),
                "parts": _parts(e),
                "base": {f: say(c["values"].get(f, {})) for f in FAMILIES},
                "shares": {f: f"{100 * e.shares[f]:.0f} %" if f in e.shares else "–" for f in FAMILIES},
            }
        )
    d = study.damping
    count = {v.value: sum(e.verdict is v for e in study.entries) for v in Verdict}
    return {
        "entries": entries, "count": count, "families": FAMILIES,
        "variants": {f: [v.changed for v in study.entries[0].answers if v.family == f] for f in FAMILIES},
        "exact": {n: f"{exact[n].hz:.2f}" for n in FEATURE_NAMES},
        "rows": [_row(p, study.base[p], study.better[p]) for p in PLANTS],
        "ladder": study.ladder, "seeds": len(study.ladder[0]["peak_hz"]), "d": d, "pictures": pictures, "robot": study.robot,
        "fourth": _fourth(study),
        "t": THRESHOLDS, "agreed": AGREED,
        "cells": study.cells, "quick": study.quick, "mode": study.ladder[0]["exact_mode_hz"],
        "peak_shift": _shifts(study), "scatter": _scatter(study), "names": [p.name for p in study.pictures],
        "captions": {p.name: p.caption for p in study.pictures},
    }  # fmt: skip


def _parts(e: Entry) -> str:
    """Parts of a compound claim with their shares."""
    texts = []
    for name, shares in e.parts().items():
        both = " / ".join(f"{100 * shares[f]:.0f} %" if f in shares else "–" for f in FAMILIES)
        texts.append(f"{name.replace('_', ' ')} {both}")
    return "; ".join(texts)


def _other(e: Entry) -> str:
    """Whether half or twice the thresholds would change the verdict."""
    changes = [
        f"{v.value} with {w} the thresholds" for v, w in ((e.at_half, "half"), (e.at_double, "twice")) if v is not e.verdict
    ]
    return "; ".join(changes)


def _scatter(study: Study) -> str:
    """How far noise alone moves the second peak of the report's pipeline [%]."""
    there = [p for p in study.ladder[0]["peak_hz"] if p is not None]
    return f"{100 * (max(there) / min(there) - 1):.1f}" if there else "-"


def _shifts(study: Study) -> str:
    """How both peaks move with the gap when they are inside the excitation, in words."""
    parts = []
    for name in ("second_peak", "first_peak"):
        base = study.better["linear"].features.get(name)
        moved = []
        for plant in ("gap_1", "gap_5", "gap_10"):
            found = study.better[plant].features.get(name)
            moved.append(f"{100 * (found.hz / base.hz - 1):+.1f} %" if base and found else "none")
        parts.append(f"{', '.join(moved)} for the {name.replace('_', ' ')}")
    return "; ".join(parts)


def page_markdown(study: Study, pictures: str = "") -> str:
    """The ledger as Markdown; ``pictures`` is the path from the page to the figures."""
    return str(_environment().get_template("page.md.j2").render(_context(study, pictures)))


def page_html(study: Study, images: Mapping[str, bytes]) -> str:
    """The ledger as one page; ``images``: the figures by name, as PNG."""
    shown = {name: base64.b64encode(png).decode("ascii") for name, png in images.items()}
    context = _context(study, "")
    context |= {"cases": context["rows"], "images": shown, "table": data_table, "theme_button": theme_button}
    body = str(_environment().get_template("page.html.j2").render(context))
    return document("simgap study: claims ledger", body, style=_STYLE)
