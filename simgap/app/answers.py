"""What the pages show of check.json and diagnosis.json: badges, sentences, tables; every text is escaped by the components."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from diagnose.check.page import WORDS
from diagnose.check.types import LogVerdict
from diagnose.report.components import Column, badge, table
from diagnose.report.figures import number, p_value, prose, unit
from diagnose.report.words import VERDICTS, effect_name
from diagnose.result import Verdict
from simgap.app.runs import Run

__all__ = ["Answer", "checked", "compared", "diagnosed"]

_MODELS = {"nominal": "model as given", "refitted": "its numbers refitted", "corrected": "corrected"}
_SEVERITIES = {"fix": "alarm", "limits": "warn"}


@dataclass(frozen=True)
class Answer:
    """An answer as a page shows it: badge, the answer in a sentence, tables (HTML), lines below them."""

    badge: Markup
    sentence: str
    tables: tuple[Markup, ...]
    notes: tuple[str, ...]


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def checked(run: Run) -> Answer | None:
    """The answer of the check; None where there is none."""
    found = _read(run.out("check") / "check.json")
    if found is None:
        return None
    word, colour = WORDS[LogVerdict(found["verdict"])]
    problems = [
        (p["recording"] or "all", badge(p["severity"], _SEVERITIES[p["severity"]]), prose(p["sentence"]), prose(p["advice"]))
        for p in found["problems"]
    ]  # fmt: skip
    understood = [(topic, prose(text)) for topic, text in found["understood"].items()]
    shows = [
        (e["family"], badge("yes", "good") if e["identifiable"] else badge("no", "warn"), prose(e["sentence"]))
        for e in found["excitation"]
    ]
    tables = []
    if problems:
        heads = (Column("recording"), Column("severity"), Column("problem", wide=True), Column("what to do", wide=True))
        tables.append(table(heads, problems, "What is wrong with the recordings"))
    tables.append(table((Column("topic"), Column("understood", wide=True)), understood, "What was understood"))
    if shows:
        columns = (Column("effects"), Column("can be told"), Column("why", wide=True))
        tables.append(table(columns, shows, "What the excitation can show"))
    several = f"{len(problems)} problems found." if len(problems) > 1 else "One problem found."
    return Answer(badge(word, colour, tiny=False), several if problems else "No problem found.", tuple(tables), ())


def diagnosed(run: Run) -> Answer | None:
    """The answer of the diagnosis; None where there is none."""
    found = _read(run.out("diagnose") / "diagnosis.json")
    if found is None:
        return None
    tables = []
    if found["findings"]:
        heads = (Column("missing"), Column("where"), Column("parameter"), Column("value", True), Column("95 % interval", True),
                   Column("unit"), Column("p, held out", True))  # fmt: skip
        tables.append(table(heads, _findings(found["findings"]), "Physics that the model lacks"))
    if found["fit"]:
        judged = found.get("judged_on") or {}
        head = f"Errors in {judged.get('channel', 'the signal')}, rms [{unit(judged.get('unit', '')) or '1'}]"
        columns = (Column("model"), Column("estimation", True), Column("held out", True))
        tables.append(table(columns, _errors(found["fit"]), head))
    notes = [prose(n) for n in found["notes"]]
    if found.get("next_experiment"):
        notes.append(f"Next: {prose(found['next_experiment'])}")
    words = VERDICTS[Verdict(found["verdict"])]
    return Answer(badge(words.badge, words.colour, tiny=False), prose(found["summary"]), tuple(tables), tuple(notes))


def _findings(findings: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for f in findings:
        told = f["parameters"].items() or [("", {"value": None, "ci95": (None, None), "unit": ""})]
        for name, e in told:
            low, high = e["ci95"]
            rows.append((
                effect_name(f["effect"]), f.get("joint") or f["place"], name, number(e["value"]),
                f"{number(low)} to {number(high)}", unit(e["unit"]), p_value(f["evidence"].get("p_value")),
            ))  # fmt: skip
    return rows


def _errors(fit: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [(text, number(fit[k]["rms"]), number(fit[k]["held_out_rms"])) for k, text in _MODELS.items() if k in fit]


def compared(runs: Sequence[Run]) -> Markup:
    """A table with a row for each run: model, recordings, verdict, findings, errors."""
    columns = (Column("run"), Column("model"), Column("recordings", wide=True), Column("verdict"), Column("findings", wide=True),
               Column("channel"), *(Column(f"{t}, rms held out", numeric=True) for t in _MODELS.values()))  # fmt: skip
    return table(columns, [_row(run) for run in runs])


def _row(run: Run) -> tuple[str | Markup, ...]:
    link = Markup('<a href="/runs/{}">{}</a>').format(run.id, run.name)
    model = run.settings.model.removeprefix("model/")
    found = _read(run.out("diagnose") / "diagnosis.json")
    if found is None:
        return (link, model, ", ".join(run.recordings), badge("not diagnosed", "info"), "–", "", "", "", "")
    words = VERDICTS[Verdict(found["verdict"])]
    judged = found.get("judged_on") or {}
    used = {r["file"] for r in found["recordings"] if r["role"] == "estimation"}  # blocks of these may be held out
    named = (r["file"] if r["file"] in used else f"{r['file']} (held out)" for r in found["recordings"])
    files = ", ".join(dict.fromkeys(named))
    findings = "; ".join(_finding(f) for f in found["findings"]) or "none"
    errors = (number(found["fit"][k]["held_out_rms"]) if k in found["fit"] else "–" for k in _MODELS)
    channel = f"{judged.get('channel', '')} [{unit(judged.get('unit', '')) or '1'}]"
    return (link, model, files, badge(words.badge, words.colour), findings, channel, *errors)


def _finding(f: Mapping[str, Any]) -> str:
    """An effect with its place and its numbers."""
    values = ", ".join(f"{number(e['value'])} {unit(e['unit'])}".strip() for e in f["parameters"].values())
    return f"{effect_name(f['effect'])} ({f.get('joint') or f['place']}): {values}"
