"""A check -> ``check.html`` (self-contained) and ``check.json``, each written in one move."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from diagnose.check.context import torque_of
from diagnose.check.types import LogCheck, LogVerdict
from diagnose.report.document import document
from diagnose.report.figures import number, prose, unit
from diagnose.report.plots import Axis, Chart, Line, Panel, Span, page_data
from mjsim.errors import InputError
from mjsim.recording import Recording
from mjsim.robot.recording import RobotRecording

__all__ = ["WORDS", "render_check", "write_check"]

WORDS = {
    LogVerdict.READY: ("Ready", "good"),
    LogVerdict.LIMITS: ("Usable with limits", "warn"),
    LogVerdict.FIX: ("Fix first", "alarm"),
}  # fmt: skip
_CHANNELS = ("command", "torque", "velocity", "angle")


def write_check(check: LogCheck, recordings: Sequence[Recording | RobotRecording], model: str, out: Path) -> None:
    """Write both files into the folder ``out``. Raises InputError where it cannot be written."""
    texts = {
        "check.json": json.dumps(_finite({"model": model, **check.as_dict()}), indent=2) + "\n",
        "check.html": render_check(check, recordings, model),
    }
    parts = []
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            parts.append(out / f".{name}.part")
            parts[-1].write_text(text, encoding="utf-8")
        for part, name in zip(parts, texts, strict=True):
            os.replace(part, out / name)
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})", "a writable folder", "choose another --out") from None
    finally:
        for part in parts:
            if part.parent.is_dir():
                part.unlink(missing_ok=True)


def render_check(check: LogCheck, recordings: Sequence[Recording | RobotRecording], model: str) -> str:
    """The page as text."""
    from jinja2 import Environment, StrictUndefined

    from diagnose.report.components import Column, chart_figure, table, theme_button

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "unit": unit, "prose": prose}
    template = environment.from_string((files("diagnose.check") / "page.html.j2").read_text(encoding="utf-8"))
    word, colour = WORDS[check.verdict]
    drawn = [
        (r.source, _of_joints(check, r, i) if isinstance(r, RobotRecording) else _charts(check, r, i))
        for i, r in enumerate(recordings)
    ]
    columns = [Column("Family"), Column("Identifiable"), Column("Why", wide=True)]
    excitation = [(prose(e.family), "yes" if e.identifiable else "no", prose(e.sentence)) for e in check.excitation]
    names = ", ".join(r.source for r in recordings)
    body = template.render(
        check=check, word=word, colour=colour, sentence=check.sentence, model=model, names=names, many=len(recordings) > 1,
        theme=theme_button(), excitation=table(columns, excitation),
        drawn=[(source, [chart_figure(chart, prose(caption)) for chart, caption in charts]) for source, charts in drawn],
    )  # fmt: skip
    charts = [chart for _, found in drawn for chart, _ in found]
    return document(f"{word}: check of {names}", body, page_data(charts) if charts else None)


def _charts(check: LogCheck, recording: Recording, index: int) -> list[tuple[Chart, str]]:
    """Each channel over time with its caption, and the torque that the motion needs; problems are shaded."""
    out: list[tuple[Chart, str]] = []
    mine = [p for p in check.problems if p.recording == recording.source]
    for channel in _CHANNELS:
        values = torque_of(recording) if channel == "torque" else getattr(recording, channel)
        if values is None:
            continue
        shown = [p for p in mine if p.marks and p.channel in (channel, "time")]
        spans = tuple(Span(a, b, colour="alarm") for p in shown for a, b in p.marks)
        named = ", ".join(dict.fromkeys(p.problem.replace("_", " ") for p in shown))
        line = Line(channel, recording.time, values, "corrected", 1.1)
        out.append(
            (
                _chart(f"c{index}-{channel}", channel, unit(recording.units.get(channel, "")), recording.source, (line,), spans),
                f"{channel.capitalize()}. Shaded: {named}." if shown else f"{channel.capitalize()}.",
            )
        )
    trace = check.torque.get(recording.source)
    if trace is not None:
        lines = (
            Line("logged", trace.time, trace.logged, "measured", 1.6),
            Line("needed for the motion", trace.time, trace.needed, "refitted", 1.1),
        )
        u = unit(recording.units.get("torque", ""))
        caption = "Torque in the band of the check, at the estimated delay, and what the motion needs, all coefficients free."
        out.append((_chart(f"c{index}-needed", "torque", u, recording.source, lines, ()), caption))
    return out


def _of_joints(check: LogCheck, recording: RobotRecording, index: int) -> list[tuple[Chart, str]]:
    """Position of each joint over time with its command, and its torque."""
    out: list[tuple[Chart, str]] = []
    for k, name in enumerate(recording.joints):
        length = check.measured[recording.source][name]["unit"]
        lines = [Line("position", recording.time, recording.angle[:, k], "measured", 1.6)]
        if recording.command is not None and recording.has("command", name):
            lines.append(Line("command", recording.time, recording.command[:, k], "corrected", 1.1))
        out.append(
            (_chart(f"c{index}-{k}-angle", name, length, recording.source, tuple(lines), ()), f"{name}: position and command.")
        )
        if recording.torque is not None and recording.has("torque", name):
            torque = (Line("torque", recording.time, recording.torque[:, k], "corrected", 1.1),)
            force = "N" if length == "m" else "N m"
            out.append((_chart(f"c{index}-{k}-torque", name, force, recording.source, torque, ()), f"{name}: torque."))
    return out


def _chart(key: str, channel: str, u: str, source: str, lines: tuple[Line, ...], spans: tuple[Span, ...]) -> Chart:
    panel = Panel(Axis("time", "s"), Axis(channel, u), lines, spans)
    alt = f"{' and '.join(line.name for line in lines)} of {source} over time"
    return Chart(key, alt, ((panel,),), 190)


def _finite(value: Any) -> Any:
    """JSON has no infinities."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
