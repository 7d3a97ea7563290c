"""Channels as SVG lines in the page's colours, with the stretches at which a problem shows shaded."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from diagnose.report.figures import number

__all__ = ["picture"]

_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 900, 150, 74, 8, 8, 24
_COLUMNS = 400  # of the picture: each shows the least and the largest sample in it


def picture(
    title: str, time: np.ndarray, lines: Sequence[tuple[str, str, np.ndarray]], marks: Sequence[tuple[float, float]] = ()
) -> str:
    """An <svg> element: lines (name, CSS variable of the colour, values (N,)) over time (N,) [s], marks shaded."""
    start, end = float(time[0]), float(time[-1])
    low = min(float(np.min(y)) for _, _, y in lines)
    high = max(float(np.max(y)) for _, _, y in lines)
    pad = 0.05 * (high - low) or abs(high) or 1.0
    low, high = low - pad, high + pad

    def x(t: np.ndarray | float) -> np.ndarray:
        return np.asarray(_LEFT + (np.asarray(t) - start) / max(end - start, 1e-300) * (_WIDTH - _LEFT - _RIGHT))

    def y(v: np.ndarray | float) -> np.ndarray:
        return np.asarray(_TOP + (high - np.asarray(v)) / (high - low) * (_HEIGHT - _TOP - _BOTTOM))

    parts = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(title)}"><title>{escape(title)}</title>']
    edges = [(float(x(max(a, start))), float(x(min(b, end)))) for a, b in marks]
    parts += [
        f'<rect x="{left - 0.5:.1f}" y="{_TOP}" width="{max(right - left, 0) + 1:.1f}" height="{_HEIGHT - _TOP - _BOTTOM}" '
        'fill="var(--alarm)" fill-opacity="0.28"/>'
        for left, right in edges
    ]
    for value in np.linspace(low + pad, high - pad, 3):
        parts.append(
            f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y(value):.1f}" y2="{y(value):.1f}" stroke="var(--grid)"/>'
            f'<text x="{_LEFT - 6}" y="{float(y(value)) + 4:.1f}" text-anchor="end" font-size="11" fill="var(--muted)">'
            f"{number(float(value), 3)}</text>"
        )
    for t in np.linspace(start, end, 6):
        anchor = "start" if t == start else "end" if t == end else "middle"
        parts.append(
            f'<text x="{x(t):.1f}" y="{_HEIGHT - 7}" text-anchor="{anchor}" font-size="11" fill="var(--muted)">'
            f"{number(float(t), 3)} s</text>"
        )
    for _, colour, values in lines:
        at, seen = _envelope(time, values)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x(at), y(seen), strict=True))
        parts.append(f'<polyline points="{points}" fill="none" stroke="var(--{colour})" stroke-width="1.1"/>')
    return "".join(parts) + "</svg>"


def _envelope(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The signal itself where it is short, else the least and the largest sample of each column, in turns."""
    n = len(values)
    if n <= 2 * _COLUMNS:
        return time, values
    edges = np.linspace(0, n, _COLUMNS + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)
    return np.repeat(time[edges], 2), np.column_stack([low, high]).ravel()
