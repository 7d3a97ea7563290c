"""What is written on a picture: title, time, the numbers of the moment, and their traces with a cursor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

__all__ = ["Trace", "captions", "strip"]

_INK, _SOFT, _PAPER, _GRID = (28, 32, 40), (120, 126, 136), (250, 250, 251), (222, 225, 230)
_BAND = (250, 250, 251, 190)
COLOURS = ((0, 98, 178), (213, 94, 0))  # simulation, recording: told apart by colour-blind eyes as well


@dataclass(frozen=True)
class Trace:
    """A quantity over the time of the film: name, unit, and one line for each shot, None where it was not measured."""

    name: str
    unit: str
    time: np.ndarray
    lines: tuple[np.ndarray | None, ...]


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)


def strip(traces: Sequence[Trace], names: Sequence[str], width: int, height: int, at: float, now: Sequence[int]) -> np.ndarray:
    """(height, width, 3): the traces side by side, with a cursor at time ``at`` and the values at sample ``now`` of each line."""
    image = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(image)
    small, big = _font(max(11, height // 13)), _font(max(13, height // 10))
    pad = height // 12
    wide = (width - pad) // len(traces)
    room = wide - draw.textlength(f"{traces[-1].name} [{traces[-1].unit}]", font=small) - pad
    under = len(names) > 1 and sum(draw.textlength(n, font=small) + pad for n in names) > room  # no room beside the last title
    foot = int(0.14 * height) if under else pad
    for i, trace in enumerate(traces):
        left, right, top, bottom = pad + i * wide, (i + 1) * wide, int(0.36 * height), height - foot
        draw.text((left, int(0.04 * height)), f"{trace.name} [{trace.unit}]", fill=_SOFT, font=small)
        y = int(0.17 * height)
        x = left
        for k, line in enumerate(trace.lines):
            value = "not measured" if line is None else f"{_number(float(line[min(now[k], len(line) - 1)]))}"
            draw.text((x, y), value, fill=COLOURS[k] if len(trace.lines) > 1 else _INK, font=big)
            x += wide // 2
        known = [line for line in trace.lines if line is not None and len(line)]
        low, high = (min(float(a.min()) for a in known), max(float(a.max()) for a in known)) if known else (0.0, 1.0)
        low, high = min(low, 0.0), max(high, 0.0)
        span = (high - low) or 1.0
        t0, t1 = float(trace.time[0]), float(trace.time[-1])

        def place(v: float, low: float = low, span: float = span, top: int = top, bottom: int = bottom) -> float:
            return bottom - (v - low) / span * (bottom - top)

        zero = place(0.0)
        draw.line([(left, zero), (right, zero)], fill=_GRID, width=1)
        for k, line in reversed(list(enumerate(trace.lines))):
            if line is not None:
                _draw(draw, line, left, right, place, COLOURS[k])
        x = int(left + (right - left) * (at - t0) / ((t1 - t0) or 1.0))
        draw.line([(x, top), (x, bottom)], fill=_INK, width=2)
    if len(names) > 1:
        x = width - pad
        for k in reversed(range(len(names))):
            x -= int(draw.textlength(names[k], font=small))
            draw.text((x, int((0.87 if under else 0.04) * height)), names[k], fill=COLOURS[k], font=small)
            x -= pad
    return np.asarray(image)


def _draw(draw: ImageDraw.ImageDraw, line: np.ndarray, left: int, right: int, place, colour) -> None:  # type: ignore[no-untyped-def]
    """A long record as the band between the least and the largest sample of each pixel column."""
    columns = max(2, right - left)
    if len(line) <= 2 * columns:
        x = np.linspace(left, right, len(line))
        draw.line([(a, place(float(v))) for a, v in zip(x, line, strict=True)], fill=colour, width=1)
        return
    edges = np.linspace(0, len(line), columns + 1).astype(int)
    for c in range(columns):
        part = line[edges[c] : edges[c + 1] + 1]
        draw.line([(left + c, place(float(part.max()))), (left + c, place(float(part.min())))], fill=colour, width=1)


def _number(x: float) -> str:
    return f"{x:+.2f}" if abs(x) < 100 else f"{x:+.0f}"


def captions(
    scene: np.ndarray, title: str, time: str, said: Sequence[str], colour: tuple[int, int, int] | None = None
) -> np.ndarray:
    """Title and time at the top of a scene, lines at its foot."""
    image = Image.fromarray(scene)
    draw = ImageDraw.Draw(image, "RGBA")
    width, height = image.size
    big, small = _font(max(15, height // 24)), _font(max(12, height // 36))
    step = int(height / 28)
    draw.rectangle([(0, 0), (width, 14 + max(15, height // 24))], fill=_BAND)  # a scene may be dark or light
    if said:
        draw.rectangle([(0, height - 14 - len(said) * step), (width, height)], fill=_BAND)
    room = width - 42 - draw.textlength(time, font=big)
    while title and draw.textlength(title, font=big) > room:
        title = title[:-2]
    draw.text((14, 8), title, fill=colour or _INK, font=big)
    draw.text((width - 14 - draw.textlength(time, font=big), 8), time, fill=_INK, font=big)
    y = height - 8 - len(said) * step
    for line in said:
        while line and draw.textlength(line, font=small) > width - 28:
            line = line[:-2]
        draw.text((14, y), line, fill=_INK, font=small)
        y += step
    return np.asarray(image)
