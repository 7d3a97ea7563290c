"""Plots as data: one description, drawn by Plotly on the page and by matplotlib for print and where no script runs.

A `Chart` is a grid of panels with lines, bands and marked stretches. An `Explorer` shows recordings beside models: signals and
errors over time, the spectrum of an error, an error over a state, with one cursor and one selection through all of them. Both are
put on a page by `components.chart_figure` and `components.explorer_section`, which return HTML; `page_data` returns what the
page's script needs of them, for `document.document`.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

__all__ = ["Axis", "Band", "Chart", "Explorer", "Line", "Panel", "Signals", "Span", "page_data"]

BUDGET = 3_600_000  # characters of encoded signals of a page: with the library and the rest it stays below 6 MB
SINGLE, HALF = 16 / 3, 8 / 3  # characters of a sample in base64: single precision, 16 bits


@dataclass(frozen=True)
class Axis:
    """An axis: what it shows and in which unit (empty of a pure number); logarithmic; its range, by default that of the data."""

    name: str
    unit: str = ""
    log: bool = False
    limits: tuple[float, float] | None = None

    @property
    def title(self) -> str:
        """Name and unit in print."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, eq=False)
class Line:
    """y (N,) over x (N,); colour: name of a variable of the theme; dash: "", "dash" or "dot"; points: drawn as well."""

    name: str
    x: np.ndarray
    y: np.ndarray
    colour: str
    width: float = 1.3
    dash: str = ""
    points: bool = False


@dataclass(frozen=True, eq=False)
class Band:
    """The stretch between low (N,) and high (N,) over x (N,)."""

    name: str
    x: np.ndarray
    low: np.ndarray
    high: np.ndarray
    colour: str = "band"


@dataclass(frozen=True)
class Span:
    """A marked stretch of the horizontal axis, and what is written above it."""

    low: float
    high: float
    label: str = ""
    colour: str = "band"


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes with what is drawn in it, back to front."""

    x: Axis
    y: Axis
    marks: tuple[Line | Band, ...]
    spans: tuple[Span, ...] = ()
    title: str = ""


@dataclass(frozen=True, eq=False)
class Chart:
    """A grid of panels, row by row; alt: the text in its place for screen readers. height [px] of the whole at full width.

    Panels of a column share the horizontal axis. widths: of the columns, relative.
    """

    key: str
    alt: str
    rows: tuple[tuple[Panel, ...], ...]
    height: int = 260
    widths: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Signals:
    """A recording and what models make of it, on one grid (M,).

    models: name -> signal, in the order in which they are drawn; states: name -> (values, unit); counted: samples on which models
    are judged; sigma: rms of the noise, not a number where it is not known. film: data URI of a film, first moment and speed.
    """

    source: str
    role: str
    time: np.ndarray
    measured: np.ndarray
    models: Mapping[str, np.ndarray]
    states: Mapping[str, tuple[np.ndarray, str]] = field(default_factory=dict)
    counted: np.ndarray | None = None
    sigma: float = float("nan")


@dataclass(frozen=True, eq=False)
class Explorer:
    """Recordings that are looked at together. names: model -> what it is called; colours: model -> (variable, dash).

    error_of: the model whose error is selected first; static: a chart of each recording for print.
    """

    key: str
    channel: str
    unit: str
    recordings: tuple[Signals, ...]
    names: Mapping[str, str]
    colours: Mapping[str, tuple[str, str]]
    error_of: str
    static: tuple[Chart, ...] = ()


def page_data(charts: Sequence[Chart] = (), explorers: Sequence[Explorer] = (), budget: float = BUDGET) -> dict[str, Any]:
    """What the page's script draws from.

    Signals are held in single precision at every sample. Where all of them would take more than ``budget`` characters, each
    recording is thinned by the same factor to the samples at which an error is least and greatest in each stretch.
    """
    whole = sum(_size(s) for e in explorers for s in e.recordings)
    share = min(1.0, budget / whole) if whole else 1.0
    return {
        "charts": {c.key: _chart(c) for c in charts},
        "explorers": {e.key: _explorer(e, share) for e in explorers},
    }


def _size(s: Signals) -> float:
    return len(s.time) * (SINGLE * (1 + len(s.models)) + HALF * len(s.states))


def _chart(c: Chart) -> dict[str, Any]:
    return {
        "height": c.height,
        "widths": list(c.widths),
        "rows": [[_panel(p) for p in row] for row in c.rows],
    }


def _panel(p: Panel) -> dict[str, Any]:
    return {
        "x": _axis(p.x),
        "y": _axis(p.y),
        "title": p.title,
        "marks": [_mark(m) for m in p.marks],
        "spans": [{"low": s.low, "high": s.high, "label": s.label, "colour": s.colour} for s in p.spans],
    }


def _axis(a: Axis) -> dict[str, Any]:
    return {"title": a.title, "log": a.log, "limits": list(a.limits) if a.limits else None}


def _mark(m: Line | Band) -> dict[str, Any]:
    if isinstance(m, Band):
        return {
            "kind": "band",
            "name": m.name,
            "x": _single(m.x),
            "low": _single(m.low),
            "high": _single(m.high),
            "colour": m.colour,
        }
    return {
        "kind": "line", "name": m.name, "x": _grid(m.x), "y": _single(m.y), "colour": m.colour, "width": m.width, "dash": m.dash,
        "points": m.points,
    }  # fmt: skip


def _explorer(e: Explorer, share: float) -> dict[str, Any]:
    return {
        "channel": e.channel,
        "unit": e.unit,
        "models": [
            {"key": k, "name": e.names[k], "colour": e.colours[k][0], "dash": e.colours[k][1]}
            for k in e.names
            if any(k in s.models for s in e.recordings)
        ],
        "error_of": e.error_of,
        "recordings": [_signals(s, share, e.error_of) for s in e.recordings],
    }


def _signals(s: Signals, share: float, error_of: str) -> dict[str, Any]:
    keep = slice(None) if share >= 1.0 else _kept(s, share, error_of)
    out: dict[str, Any] = {
        "source": s.source,
        "role": s.role,
        "time": _grid(s.time[keep]),
        "samples": len(s.time),
        "measured": _single(s.measured[keep]),
        "models": {k: _single(y[keep]) for k, y in s.models.items()},
        "states": {
            k: {"unit": u, "values": _rounded(y[keep]) if np.all(np.isfinite(y)) else _single(y[keep])}
            for k, (y, u) in s.states.items()
        },
        "sigma": float(s.sigma) if np.isfinite(s.sigma) else None,
    }
    counted = None if s.counted is None else s.counted[keep]
    if counted is not None and not counted.all():
        edges = np.flatnonzero(np.diff(np.concatenate([[False], counted, [False]]).astype(int)))
        out["counted"] = edges.tolist()  # starts and ends in turns
    return out


def _kept(s: Signals, share: float, error_of: str) -> np.ndarray:
    """Indices at which the error of the model is least and greatest in each stretch, so many that ``share`` of all is kept."""
    n = len(s.time)
    y = s.models.get(error_of, next(iter(s.models.values()), s.measured))
    width = max(2, int(np.ceil(2.0 / share)))
    count = -(-n // width)
    e = np.full(count * width, np.nan)
    e[:n] = s.measured - y
    table = e.reshape(count, width)
    low = np.argmin(np.where(np.isfinite(table), table, np.inf), axis=1)
    high = np.argmax(np.where(np.isfinite(table), table, -np.inf), axis=1)
    at = np.arange(count) * width
    return np.unique(np.minimum(np.concatenate([at + low, at + high]), n - 1))


def _grid(x: np.ndarray) -> dict[str, Any]:
    """A uniform grid by its start and step, else its values."""
    n = len(x)
    if n > 2:
        step = float(x[-1] - x[0]) / (n - 1)
        if step > 0 and np.allclose(np.diff(x), step, rtol=1e-3, atol=0):
            return {"start": float(x[0]), "step": step, "n": n}
    return {"start": float(x[0]) if n else 0.0, "f": _base64(np.asarray(x - (x[0] if n else 0.0), "<f4"))}


def _single(y: np.ndarray) -> dict[str, Any]:
    return {"f": _base64(np.asarray(y, "<f4"))}


def _rounded(y: np.ndarray) -> dict[str, Any]:
    """Values in 65,535 steps of their range; a state is only where a point is drawn."""
    low, high = float(np.min(y)), float(np.max(y))
    step = (high - low) / 65_534 or 1.0
    return {"low": low, "step": step, "q": _base64(np.asarray(np.round((y - low) / step), "<u2"))}


def _base64(a: np.ndarray) -> str:
    return base64.b64encode(a.tobytes()).decode("ascii")


def finite(values: Iterable[np.ndarray]) -> np.ndarray:
    """All finite values of several arrays (K,)."""
    return np.concatenate([np.asarray(v, float)[np.isfinite(v)] for v in values] or [np.empty(0)])
