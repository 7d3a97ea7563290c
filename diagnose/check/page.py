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
from diagnose.check.pictures import picture
from diagnose.check.registry import checks
from diagnose.check.types import LogCheck, LogVerdict
from diagnose.report.figures import number, prose, unit
from mjsim.errors import InputError
from mjsim.recording import Recording

__all__ = ["WORDS", "render_check", "write_check"]

WORDS = {
    LogVerdict.READY: ("Ready", "good"),
    LogVerdict.LIMITS: ("Usable with limits", "warn"),
    LogVerdict.FIX: ("Fix first", "alarm"),
}  # fmt: skip
_CHANNELS = ("torque", "velocity", "angle")


def write_check(check: LogCheck, recordings: Sequence[Recording], model: str, out: Path) -> None:
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


def render_check(check: LogCheck, recordings: Sequence[Recording], model: str) -> str:
    """The page as text."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "unit": unit, "prose": prose}
    template = environment.from_string((files("diagnose.check") / "page.html.j2").read_text(encoding="utf-8"))
    word, colour = WORDS[check.verdict]
    return template.render(
        check=check, word=word, colour=colour, sentence=check.sentence, model=model,
        names=", ".join(r.source for r in recordings), many=len(recordings) > 1,
        questions=[c.question for c in checks().values()],
        css=(files("diagnose.report") / "page.css").read_text(encoding="utf-8"),
        drawn=[(r.source, _drawn(check, r)) for r in recordings],
    )  # fmt: skip


def _drawn(check: LogCheck, recording: Recording) -> list[tuple[str, list[tuple[str, str]], str]]:
    """Caption, keys of the colours and drawing of each channel, and of the torque that the motion needs."""
    out: list[tuple[str, list[tuple[str, str]], str]] = []
    mine = [p for p in check.problems if p.recording == recording.source]
    for channel in _CHANNELS:
        values = torque_of(recording) if channel == "torque" else recording.velocity if channel == "velocity" else recording.angle
        if values is None:
            continue
        shown = [p for p in mine if p.marks and p.channel in (channel, "time")]
        marks = [m for p in shown for m in p.marks]
        u = unit(recording.units.get(channel, ""))
        what = f"{channel}{f' [{u}]' if u else ''}"
        caption = what + (f"; shaded: {', '.join(dict.fromkeys(p.problem.replace('_', ' ') for p in shown))}" if shown else "")
        out.append((caption, [], picture(what, recording.time, [(channel, "corrected", values)], marks)))
    trace = check.torque.get(recording.source)
    if trace is not None:
        lines = [("logged", "measured", trace.logged), ("needed for the motion", "refitted", trace.needed)]
        caption = "Torque in the band of the check, at the estimated delay, and what the motion needs, all coefficients free:"
        out.append((caption, [(n, c) for n, c, _ in lines], picture("torque logged and needed", trace.time, lines)))
    return out


def _finite(value: Any) -> Any:
    """JSON has no infinities."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
