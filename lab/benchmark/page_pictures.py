"""The pictures of the benchmark as SVG text in the page's colours: power curves, and how the cases of each level ended."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

__all__ = ["OUTCOMES", "levels", "power", "power_grid", "small_power", "standalone"]

# outcome -> colour of its part of a bar: found in blue, honest silence grey, wrong in red
OUTCOMES = {
    "right": "--corrected", "right up to equivalents": "--equal", "right and one too many": "--extra", "part of it": "--part",
    "unexplained": "--nominal", "missed": "--measured", "change of parameters missed": "--measured",
    "wrong name": "--alarm", "false alarm": "--alarm", "error": "--ink",
}  # fmt: skip

_ROOT = (
    ":root{--ink:#16191d;--muted:#5b6470;--grid:#e4e7ec;--paper:#fff;--measured:#a3acb8;--nominal:#6b7480;--refitted:#c2410c;"
    "--corrected:#0b63b5;--band:#cfd6df99;--alarm:#9b1c31;--equal:#5aa2e0;--extra:#b9d7f2;--part:#e3b15f}"
    "@media (prefers-color-scheme:dark){:root{--ink:#e8ebef;--muted:#a0a9b4;--grid:#2a3038;--paper:#14171b;--measured:#77828f;"
    "--nominal:#a8b1bc;--refitted:#ff9559;--corrected:#6bb6ff;--band:#46505c99;--alarm:#ffa3b1;--equal:#3f78ad;--extra:#274c70;"
    "--part:#a87b2e}}"
)


def standalone(svg: str) -> str:
    """The drawing as a file of its own, with the page's colours inside."""
    style = f"<style>{_ROOT} svg{{background:var(--paper);font-family:system-ui,sans-serif}}</style>"
    head, _, body = svg.partition(">")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{head}>{style}{body}\n'


def _svg(width: float, height: float, alt: str, body: Sequence[str]) -> str:
    parts = "".join(body)
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(alt)}" xmlns="http://www.w3.org/2000/svg">'
        f"<title>{escape(alt)}</title>{parts}</svg>"
    )


def _text(x: float, y: float, text: str, *, size: float = 12, anchor: str = "start", colour: str = "--ink") -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="{anchor}"'
    return f'<text {place} fill="var({colour})">{escape(text)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, width: float = 1, dash: str = "") -> str:
    extra = f' stroke-dasharray="{dash}"' if dash else ""
    place = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {place} stroke="var({colour})" stroke-width="{width:g}"{extra}/>'


def _path(points: Sequence[tuple[float, float]], colour: str, width: float) -> str:
    d = "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    return f'<path d="{d}" fill="none" stroke="var({colour})" stroke-width="{width:g}"/>'


def _dot(x: float, y: float, r: float, colour: str, filled: bool) -> str:
    fill = f"var({colour})" if filled else "none"
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r:g}" fill="{fill}" stroke="var({colour})" stroke-width="1" opacity="0.75"/>'


def _scale(low: float, high: float, left: float, right: float) -> Callable[[float], float]:
    """Size on a logarithmic axis."""
    a, b = math.log10(low), math.log10(high)
    return lambda s: left + (math.log10(min(max(s, low), high)) - a) / (b - a) * (right - left)


def _limits(curves: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    sizes = [s for c in curves for s, _ in c["cases"] if s > 0] or [0.1, 10.0]
    low, high = 10 ** math.floor(math.log10(min(sizes))), 10 ** math.ceil(math.log10(max(sizes)))
    return max(low, 1e-3), max(high, low * 10)


def _ticks(low: float, high: float) -> list[float]:
    return [10.0**k for k in range(round(math.log10(low)), round(math.log10(high)) + 1)]


def power(detected: Mapping[str, Any], named: Mapping[str, Any]) -> str:
    """Chance to be seen, and to be named rightly, over the size; each case as a tick above or below."""
    width, height, left, right, top, bottom = 760, 330, 60, 745, 50, 260
    low, high = _limits([detected])
    x = _scale(low, high, left, right)

    def y(p: float) -> float:
        return bottom - p * (bottom - top)

    body = []
    for p in (0, 0.25, 0.5, 0.75, 0.9, 1):
        body += [_line(left, y(p), right, y(p), "--grid"), _text(left - 8, y(p) + 4, f"{100 * p:.0f} %", anchor="end")]
    for s in _ticks(low, high):
        body += [_line(x(s), top, x(s), bottom, "--grid"), _text(x(s), bottom + 36, f"{s:g}", anchor="middle")]
    body.append(_text((left + right) / 2, bottom + 56, "size of the effect behind a refit [rms of the noise]", anchor="middle"))
    where = (("--corrected", "seen: the verdict says that something is missing", detected, 0),
             ("--refitted", "named: verdict and effect right", named, 1))  # fmt: skip
    for colour, label, curve, row in where:
        at = left + 330 * row
        body += [_line(at, 18, at + 26, 18, colour, 2.4), _text(at + 32, 22, label)]
        for b in curve["bins"] if row == 0 else ():
            middle, share = x(math.sqrt(max(b["low"], low) * max(b["high"], low))), b["seen"] / b["n"]
            body += [_line(middle, y(b["ci95"][0]), middle, y(b["ci95"][1]), colour, 1.3)]
            body += [_dot(middle, y(share), 3.6, colour, True)]
        for size, seen in curve["cases"]:
            tick = (top - 12 + 5 * row) if seen else (bottom + 8 + 6 * row)
            body.append(_line(x(size), tick - 2.5, x(size), tick + 2.5, colour, 1.3))
        if curve["curve"]:
            points = [(x(s), y(p)) for s, p in zip(curve["curve"]["size"], curve["curve"]["chance"], strict=True)]
            body.append(_path(points, colour, 2.4))
    alt = "Chance that an effect is seen and that it is named, over its size in units of the noise"
    return _svg(width, height, alt, body)


def _reach(x: Callable[[float], float], limits: Sequence[float | None], y: float, colour: str, left: float, right: float) -> str:
    """An interval as a bar; where it is open it runs to the frame and is dashed."""
    low, high = limits
    dash = "" if low and high else "3 2"
    return _line(x(low) if low else left, y, x(high) if high else right, y, colour, 1.4, dash)


def power_grid(curves: Mapping[str, Mapping[str, Any]], label: Callable[[str], str]) -> str:
    """A panel for each effect: the chance to be seen over the size, with the 50 % and 90 % points, or why there is no curve."""
    columns, wide, tall, gap = 3, 236, 78, 16
    low, high = _limits([c["detected"] for c in curves.values()])
    body = []
    for i, (effect, both) in enumerate(curves.items()):
        c = both["detected"]
        left, top = 8 + (i % columns) * (wide + gap), 22 + (i // columns) * (tall + 46)
        right, bottom = left + wide, top + tall
        x = _scale(low, high, left, right)

        def y(p: float, bottom: int = bottom) -> float:
            return bottom - p * tall

        body.append(_text(left, top - 9, f"{label(effect)}, {c['seen']} of {c['n']} seen", size=11))
        body += [_line(left, y(p), right, y(p), "--grid") for p in (0, 0.5, 0.9, 1)]
        ticks = _ticks(low, high)
        for s in ticks:
            anchor = {ticks[0]: "start", ticks[-1]: "end"}.get(s, "middle")  # the panels stand close
            body += [_line(x(s), top, x(s), bottom, "--grid"), _text(x(s), bottom + 20, f"{s:g}", size=9, anchor=anchor)]
        for size, seen in c["cases"]:
            tick = top + 3 if seen else bottom + 6
            body.append(_line(x(size), tick - 3, x(size), tick + 3, "--corrected" if seen else "--alarm", 1.3))
        if c["curve"]:
            points = [(x(s), y(p)) for s, p in zip(c["curve"]["size"], c["curve"]["chance"], strict=True) if s >= low]
            body.append(_path(points, "--corrected", 2))
        for key, p in (("at50", 0.5), ("at90", 0.9)):
            if any(c[f"{key}_ci95"]):
                body.append(_reach(x, c[f"{key}_ci95"], y(p), "--ink", left, right))
            if c[key] is not None and low <= c[key] <= high:
                body.append(_dot(x(c[key]), y(p), 3, "--ink", True))
    rows = -(-len(curves) // columns)
    body.append(_text(376, 22 + rows * (tall + 46), "size of the effect behind a refit [rms of the noise]", anchor="middle"))
    return _svg(
        760, 34 + rows * (tall + 46), "Chance that each effect is seen over its size, with its 50 % and 90 % points", body
    )


def small_power(curves: Mapping[str, Mapping[str, Any]], label: Callable[[str], str]) -> str:
    """One strip for each effect: every case by its size, filled when it was named, ringed when only seen, grey when missed."""
    row, left, right, top = 21, 190, 745, 30
    low, high = _limits([c["detected"] for c in curves.values()])
    x = _scale(low, high, left, right)
    bottom = top + row * len(curves)
    body = []
    for s in _ticks(low, high):
        body += [_line(x(s), top, x(s), bottom, "--grid"), _text(x(s), bottom + 16, f"{s:g}", anchor="middle")]
    legend = (("named", "--corrected", True), ("seen, not named", "--refitted", False), ("missed", "--alarm", True))
    for i, (text, colour, filled) in enumerate(legend):
        body += [_dot(left + 8 + 150 * i, 12, 4.5, colour, filled), _text(left + 18 + 150 * i, 16, text)]
    for i, (effect, c) in enumerate(curves.items()):
        y = top + row * (i + 0.5)
        body += [_text(left - 10, y + 4, label(effect), anchor="end"), _line(left, y, right, y, "--grid")]
        # both lists are sorted by size; equal sizes are the same case
        for (size, seen), (_, named) in zip(c["detected"]["cases"], c["named"]["cases"], strict=True):
            colour, filled = ("--corrected", True) if named else ("--refitted", False) if seen else ("--alarm", True)
            body.append(_dot(x(size), y, 4.5, colour, filled))
        for key, dash in (("at50", ""), ("at90", "3 2")):
            at = c["detected"][key]
            if at is not None and low <= at <= high:
                body.append(_line(x(at), y - 8, x(at), y + 8, "--ink", 1.6, dash))
    body.append(_text((left + right) / 2, bottom + 36, "size of the effect behind a refit [rms of the noise]", anchor="middle"))
    return _svg(760, bottom + 46, "Every single effect of the library by its size: named, seen or missed", body)


def _written_on(colour: str) -> str:
    """Colour of a number on a bar."""
    return "--ink" if colour in ("--measured", "--extra", "--part") else "--paper"


def levels(table: Mapping[str, Mapping[str, Any]], label: Callable[[str], str]) -> str:
    """How the cases of each level ended, as one bar each."""
    row, left, right = 27, 190, 700
    met = [o for o in OUTCOMES if any(t["outcomes"].get(o) for t in table.values())]
    body, at, line = [], 10.0, 12.0
    for o in met:
        wide = 26 + 6.7 * len(o)
        if at + wide > 750:
            at, line = 10.0, line + 19
        body += [f'<rect x="{at:.1f}" y="{line - 8:g}" width="11" height="11" fill="var({OUTCOMES[o]})"/>']
        body += [_text(at + 16, line + 2, o)]
        at += wide
    top = line + 16
    for i, (level, t) in enumerate(table.items()):
        y, n, x = top + row * i, t["right"]["n"], float(left)
        body.append(_text(left - 10, y + 15, label(level), anchor="end"))
        for o in met:
            count = t["outcomes"].get(o, 0)
            wide = count / n * (right - left)
            if count:
                title = f"<title>{escape(label(level))}: {escape(o)} {count} of {n}</title>"
                box = f'x="{x:.1f}" y="{y + 2:g}" width="{max(wide - 1.2, 0.8):.1f}" height="{row - 8}"'
                body.append(f'<rect {box} rx="2" fill="var({OUTCOMES[o]})">{title}</rect>')
                if wide > 22:
                    body.append(
                        _text(x + wide / 2, y + 16, str(count), anchor="middle", size=11, colour=_written_on(OUTCOMES[o]))
                    )
            x += wide
        body.append(_text(right + 8, y + 15, f"of {n}", colour="--muted"))
    return _svg(760, top + row * len(table) + 6, "How the cases of each level ended", body)
