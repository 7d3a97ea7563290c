"""A chart as SVG whose colours are variables of the theme: what is printed, and what stands there where no script runs."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from diagnose.report.curves import envelope
from diagnose.report.figures import power
from diagnose.report.plots import Axis, Band, Chart, Line, Panel, Span, finite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["VARIABLES", "draw"]

# colours of the theme; each is drawn in a colour that nothing else has, which is then replaced by the variable
VARIABLES = (
    "ink", "muted", "grid", "paper", "measured", "nominal", "refitted", "corrected", "band", "mapped", "alarm", "accent",
)  # fmt: skip
_DRAWN = {name: f"#{2 * i + 17:02x}{2 * i + 17:02x}{2 * i + 17:02x}" for i, name in enumerate(VARIABLES)}
_NAMED = {drawn: name for name, drawn in _DRAWN.items()}
_WIDTH = 860  # [px] at which charts are laid out
_COLUMNS = 480  # of a panel that is as wide as the page: each shows the least and the greatest sample in it
_DASHES: dict[str, Any] = {"": "-", "dash": (0, (5, 3)), "dot": (0, (1.2, 1.8))}


def _style() -> Any:
    import matplotlib as mpl

    c = _DRAWN
    return mpl.rc_context({
        "svg.fonttype": "none", "svg.hashsalt": "simgap", "font.size": 10, "axes.titlesize": 10, "axes.labelsize": 10,
        "xtick.labelsize": 9, "ytick.labelsize": 9, "legend.fontsize": 9.5, "text.color": c["ink"], "axes.labelcolor": c["ink"],
        "axes.edgecolor": c["muted"], "xtick.color": c["muted"], "ytick.color": c["muted"], "xtick.labelcolor": c["ink"],
        "ytick.labelcolor": c["ink"], "grid.color": c["grid"], "grid.linewidth": 0.7, "axes.grid": True, "axes.axisbelow": True,
        "axes.facecolor": "none", "figure.facecolor": "none", "axes.spines.top": False, "axes.spines.right": False,
        "legend.frameon": False, "lines.solid_joinstyle": "round", "path.simplify": False, "axes.linewidth": 0.8,
        "axes.unicode_minus": True, "axes.titlelocation": "left",
    })  # fmt: skip


def draw(chart: Chart) -> str:
    """An <svg> element; the same chart gives the same text."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    columns = max(len(row) for row in chart.rows)
    height = chart.height / 72
    with _style():
        figure = Figure(figsize=(_WIDTH / 72, height), dpi=72)
        FigureCanvasSVG(figure)
        grid = figure.add_gridspec(
            len(chart.rows), columns, width_ratios=chart.widths or None, left=64 / _WIDTH, right=1 - 14 / _WIDTH,
            bottom=0.62 / height, top=1 - (0.62 if _titled(chart) else 0.4) / height, wspace=0.16, hspace=0.18,
        )  # fmt: skip
        handles: dict[str, Any] = {}
        left: list[Axes] = []
        for i, row in enumerate(chart.rows):
            for k, panel in enumerate(row):
                axes = figure.add_subplot(grid[i, k])
                last = i == len(chart.rows) - 1 or k >= len(chart.rows[i + 1])
                handles |= _panel(axes, panel, _COLUMNS // columns + 60, labelled=last)
                if k == 0:
                    left.append(axes)
        figure.align_ylabels(left)
        if len(handles) > 1:
            figure.legend(
                handles.values(), handles, loc="upper left", bbox_to_anchor=(52 / _WIDTH, 1.0), ncols=len(handles),
                handlelength=2.2, columnspacing=1.6, borderaxespad=0.0,
            )  # fmt: skip
        return _svg(figure, chart)


def _titled(chart: Chart) -> bool:
    return any(p.title or any(s.label for s in p.spans) for p in chart.rows[0])


def _panel(axes: Axes, panel: Panel, columns: int, *, labelled: bool) -> dict[str, Any]:
    """Draw one panel; what the legend shows of it, by name."""
    handles: dict[str, Any] = {}
    for m in panel.marks:
        if isinstance(m, Band):
            artist: Any = axes.fill_between(m.x, m.low, m.high, color=_DRAWN[m.colour], linewidth=0)
        else:
            artist = _line(axes, m, columns)
        if m.name:
            handles.setdefault(m.name, artist)
    for axis, a, logarithm in ((axes.xaxis, panel.x, axes.set_xscale), (axes.yaxis, panel.y, axes.set_yscale)):
        if a.log:
            logarithm("log")
        _ticks(axis, a)
    low, high = panel.x.limits or _extent(finite(m.x for m in panel.marks))
    axes.set_xlim(low, high)
    if panel.y.limits:
        axes.set_ylim(*panel.y.limits)
    for axis, a in ((axes.xaxis, panel.x), (axes.yaxis, panel.y)):
        if a.log:
            _decades(axis)
    _spans(axes, panel.spans, log=panel.x.log)
    if panel.title:
        axes.set_title(panel.title)
    axes.set_ylabel(panel.y.title)
    if labelled:
        axes.set_xlabel(panel.x.title)
    else:
        axes.tick_params(labelbottom=False)
    return handles


def _line(axes: Axes, m: Line, columns: int) -> Any:
    x, y = envelope(m.x, m.y, columns)
    marker: dict[str, Any] = {"marker": "o", "markersize": 3.6, "markeredgewidth": 0} if m.points else {}
    return axes.plot(x, y, color=_DRAWN[m.colour], linewidth=m.width, linestyle=_DASHES[m.dash], **marker)[0]


def _extent(x: np.ndarray) -> tuple[float, float]:
    if not len(x):
        return 0.0, 1.0
    low, high = float(np.min(x)), float(np.max(x))
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _ticks(axis: Any, a: Axis) -> None:
    from matplotlib.ticker import MaxNLocator

    if not a.log:
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))


def _decades(axis: Any) -> None:
    """Ticks at the decades only, labelled without mathematical typesetting."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = np.log10(axis.get_view_interval())
    axis.set_major_locator(LogLocator(numticks=40 if high - low < 8 else 8))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda x, _: power(float(np.log10(x)))))


def _spans(axes: Axes, spans: Sequence[Span], *, log: bool) -> None:
    """Marked stretches, labelled where their labels do not meet."""
    low, high = axes.get_xlim()
    used: list[float] = []
    for s in spans:
        a, b = max(s.low, low), min(s.high, high)
        if not b > a:
            continue
        axes.axvspan(a, b, color=_DRAWN[s.colour], alpha=0.35 if s.colour == "alarm" else None, linewidth=0, zorder=0.4)
        at = float(np.log(a * b / low**2) / np.log(high / low) / 2) if log else ((a + b) / 2 - low) / (high - low)
        if s.label and all(abs(at - other) > 0.08 for other in used):
            used.append(at)
            axes.text(at, 1.005, s.label, transform=axes.transAxes, ha="center", va="bottom", fontsize=9)


def _svg(figure: Figure, chart: Chart) -> str:
    """The drawing in the colours and the font of the page, with ids of its own and a name for those who do not see it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->\s*", "", text, flags=re.S)
    text = re.sub(r'<g id="[^"]*">', "<g>", text)
    text = re.sub(r'(id="|href="#|url\(#)', rf"\g<1>{chart.key}-", text)
    text = re.sub(r' d="([^"]*)"', lambda m: f' d="{_short(m[1])}"', text)
    text = re.sub(r"<defs>\s*<style[^>]*>.*?</style>\s*</defs>", "", text, flags=re.S)
    text = re.sub(r' style="([^"]*)"', lambda m: _attributes(m[1]), text)
    box = re.search(r'viewBox="[^"]*"', text)
    assert box is not None
    body = text[text.index(">") + 1 :]
    return (
        f'<svg {box[0]} role="img" aria-label="{escape(chart.alt)}" xmlns="http://www.w3.org/2000/svg" '
        f'xmlns:xlink="http://www.w3.org/1999/xlink">{body}'
    )


def _attributes(style: str) -> str:
    """A style as a class of the theme's colours and presentation attributes: the page's policy allows no style attributes."""
    classes, out = [], []
    for part in style.split(";"):
        name, _, value = (p.strip() for p in part.partition(":"))
        variable = _NAMED.get(value)
        if name == "font":
            out.append(f'font-size="{re.search(r"[0-9.]+px", value)[0]}"')  # type: ignore[index]
        elif variable is not None:
            classes.append(f"{name[0]}-{variable}")
        elif name and name != "font-family":
            out.append(f'{name}="{value}"')
    return (f' class="{" ".join(classes)}"' if classes else "") + "".join(f" {a}" for a in out)


def _short(path: str) -> str:
    """Coordinates to a tenth of a point, in as few characters."""
    rounded = re.sub(r"-?\d+\.\d+", lambda m: f"{float(m[0]):.1f}".removesuffix(".0"), path)
    return re.sub(r"\s+", " ", rounded).strip()
