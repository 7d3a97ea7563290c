"""Pieces of a page as HTML: tables that become cards on a phone, bars, badges, plots, the explorer of recordings.

How a page is put together:

    charts = [plots.Chart("torque", "Torque over time, ...", rows)]
    explorers = [plots.Explorer("elbow", "torque", "N·m", recordings, names, colours, "refitted", static_charts)]
    body = header + components.chart_figure(charts[0], "Torque.") + components.explorer_section(explorers[0], "Elbow")
    document.write_page(document.document("Title", body, plots.page_data(charts, explorers)), path)

Every text that is handed to a function here is escaped unless it is `Markup`; keys of charts and explorers are letters, digits
and hyphens, and unique on a page. A page without plots leaves out the data: ``document.document("Title", body)``. Colours are the
names in `static.VARIABLES`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from markupsafe import Markup

from diagnose.report.plots import Chart, Explorer
from diagnose.report.static import draw

__all__ = ["Cell", "Column", "badge", "bar", "chart_figure", "data_table", "explorer_section", "table", "theme_button"]

Cell: TypeAlias = "str | Markup"


@dataclass(frozen=True)
class Column:
    """A column: its head; numeric: aligned to the right; wide: what it holds is wrapped and not kept on one line."""

    head: str
    numeric: bool = False
    wide: bool = False


def data_table(
    heads: Sequence[str], rows: Iterable[Sequence[Cell]], *, numeric: Collection[int] = (), wide: Collection[int] = (),
    chosen: Sequence[int] = (), caption: Cell = "",
) -> Markup:  # fmt: skip
    """A `table` by the heads of its columns; ``numeric`` and ``wide``: indices of the columns that are."""
    columns = [Column(head, i in numeric, i in wide) for i, head in enumerate(heads)]
    return table(columns, rows, caption, chosen)


def table(columns: Sequence[Column], rows: Iterable[Sequence[Cell]], caption: Cell = "", chosen: Sequence[int] = ()) -> Markup:
    """A table whose first column heads its rows; on a narrow screen each row is a card with the heads beside the values.

    ``chosen``: indices of rows that stand out.
    """
    heads = Markup("").join(Markup('<th scope="col" role="columnheader"{}>{}</th>').format(_class(c), c.head) for c in columns)
    body = []
    for i, row in enumerate(rows):
        first, *others = zip(columns, row, strict=True)
        cells = [Markup('<th scope="row" role="rowheader">{}</th>').format(first[1])]
        cells += [
            Markup('<td role="cell" data-label="{}"{}>{}</td>').format(
                c.head, _class(c, empty=not str(cell).strip()), _whole(cell)
            )
            for c, cell in others
        ]
        mark = Markup(' class="chosen"') if i in chosen else Markup("")
        body.append(Markup('<tr role="row"{}>{}</tr>').format(mark, Markup("").join(cells)))
    head = Markup("<caption>{}</caption>").format(caption) if caption else Markup("")
    return Markup(
        '<table class="cards" role="table">{}<thead role="rowgroup"><tr role="row">{}</tr></thead>'
        '<tbody role="rowgroup">\n{}\n</tbody></table>'
    ).format(head, heads, Markup("\n").join(body))


def _whole(cell: Cell) -> Cell:
    """A cell that a card shows as one piece: elements and text in it would be set apart."""
    return Markup("<span>{}</span>").format(cell) if isinstance(cell, Markup) and "<" in cell else cell


def _class(c: Column, *, empty: bool = False) -> Markup:
    names = [n for n, on in (("n", c.numeric), ("wide", c.wide), ("empty", empty)) if on]
    return Markup(' class="{}"').format(" ".join(names)) if names else Markup("")


def badge(text: Cell, colour: str, *, tiny: bool = True) -> Markup:
    """A word in a frame; colour: good, info, warn or alarm."""
    return Markup('<span class="badge{} {}">{}</span>').format(" tiny" if tiny else "", colour, text)


def bar(share: float, colour: str = "refitted") -> Markup:
    """A horizontal bar of a share between 0 and 1; the number itself has to stand beside it."""
    width = 100 * min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0
    return Markup(
        '<svg class="bar" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true" focusable="false">'
        '<rect class="f-grid" width="100" height="8"/><rect class="f-{}" width="{}" height="8"/></svg>'
    ).format(colour, f"{width:.1f}")


def theme_button() -> Markup:
    """The switch between the system's colours, light and dark; it is there only where scripts run."""
    return Markup('<button type="button" class="js theme" id="theme" aria-live="polite">Colours: system</button>')


def _key(key: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9-]+", key):
        raise ValueError(f"{key!r} is no key of a plot: letters, digits and hyphens")
    return key


def chart_figure(chart: Chart, caption: Cell = "") -> Markup:
    """A chart, interactive where scripts run; its keys are those of the explorer (see `page.js`)."""
    caption = Markup("<figcaption>{}</figcaption>").format(caption) if caption else Markup("")
    return Markup(
        '<figure class="plot" data-chart="{key}">{tools}<div class="live" id="chart-{key}" tabindex="0" role="group" '
        'aria-label="{alt}" aria-describedby="keys"></div><div class="static">{svg}</div>{caption}</figure>'
    ).format(key=_key(chart.key), alt=chart.alt, tools=_CHART_TOOLS, svg=Markup(draw(chart)), caption=caption)


def _button(action: str, text: str, label: str, *, pressed: bool | None = None) -> Markup:
    state = "" if pressed is None else Markup(' aria-pressed="{}"').format("true" if pressed else "false")
    return Markup('<button type="button" data-do="{}" aria-label="{}" title="{}"{}>{}</button>').format(
        action, label, label, state, text
    )


_CHART_TOOLS = Markup('<div class="tools js" role="group" aria-label="View of this plot">{}</div>').format(
    Markup("").join(
        (
            _button("in", "+", "Zoom in"),
            _button("out", "\N{MINUS SIGN}", "Zoom out"),
            _button("reset", "Reset", "Show all"),
        )
    )
)
_MODES = Markup("").join(
    (
        _button("zoom", "Zoom", "Drag to zoom", pressed=True),
        _button("pan", "Pan", "Drag to move", pressed=False),
        _button("select", "Select", "Drag to select a stretch", pressed=False),
    )
)
_STEPS = Markup("").join(
    (
        _button("left", "\N{LEFTWARDS ARROW}", "Earlier"),
        _button("right", "\N{RIGHTWARDS ARROW}", "Later"),
        _button("in", "+", "Zoom in"),
        _button("out", "\N{MINUS SIGN}", "Zoom out"),
        _button("reset", "Reset", "Show all"),
    )
)


def _live(key: str, part: str, alt: str, printed: Sequence[Chart] = ()) -> Markup:
    statics = Markup("").join(
        Markup('<div class="static">{}<p class="small">{}.</p></div>').format(Markup(draw(c)), c.alt) for c in printed
    )
    return Markup(
        '<figure class="plot" data-part="{part}"><div class="live" id="{key}-{part}" tabindex="0" role="group" '
        'aria-label="{alt}" aria-describedby="keys"></div>{statics}<figcaption data-caption="{part}"></figcaption></figure>'
    ).format(key=key, part=part, alt=alt, statics=statics)


def explorer_section(explorer: Explorer, title: str, film: Markup | None = None) -> Markup:
    """The explorer of recordings: choice of recording and error, plots with one cursor and one selection, slider, readout.

    ``film``: a <video> that follows the slider. Without scripts and in print the static charts stand in its place.
    """
    key, channel = _key(explorer.key), explorer.channel
    recordings = Markup("").join(
        Markup('<option value="{}"{}>{}</option>').format(
            i, Markup(" selected") if i == _first(explorer) else "", f"{s.source} ({s.role.replace('-', ' ')})"
        )
        for i, s in enumerate(explorer.recordings)
    )
    models = Markup("").join(
        Markup('<option value="{}"{}>{}</option>').format(k, Markup(" selected") if k == explorer.error_of else "", name)
        for k, name in explorer.names.items()
        if any(k in s.models for s in explorer.recordings)
    )
    states = Markup("").join(
        Markup('<option value="{}">{}</option>').format(name, name)
        for name in dict.fromkeys(name for s in explorer.recordings for name in s.states)
    )
    return Markup(_SECTION).format(
        key=key, title=title, recordings=recordings, models=models, states=states, modes=_MODES, steps=_STEPS, channel=channel,
        time=_live(key, "time", f"{channel} over time, measured and predicted, with the errors of the models below",
                   explorer.static),
        frequency=_live(key, "frequency", f"Spectral density of the error in {channel} over frequency"),
        state=_live(key, "state", f"Error in {channel} over a state"), film=film or "",
        hidden=Markup(" hidden") if not states else "",
    )  # fmt: skip


def _first(explorer: Explorer) -> int:
    """The held-out recording where there is one: it took no part in the fits."""
    return next((i for i, s in enumerate(explorer.recordings) if s.role.startswith("held")), 0)


_SECTION = """<div class="explorer" data-explorer="{key}" role="region" aria-label="{title}">
<div class="controls js">
<label>Recording <select data-choose="recording">{recordings}</select></label>
<label>Error of <select data-choose="model">{models}</select></label>
<div class="tools" role="group" aria-label="What dragging does">{modes}</div>
<div class="tools" role="group" aria-label="Stretch shown">{steps}</div>
</div>
<div class="legend js" role="group" aria-label="Curves shown"></div>
{time}
<div class="scrub js"><button type="button" data-do="play" aria-pressed="false">Play</button>
<input type="range" data-choose="moment" min="0" max="1" step="1" value="0" aria-label="Moment of the recording">
<output data-say="moment"></output></div>
<dl class="readout js" data-say="values"></dl>
{film}
<div class="pair">
{frequency}
<div class="over"{hidden}><label class="js">Error over <select data-choose="state">{states}</select></label>{state}</div>
</div>
<form class="selection js" aria-label="Selection">
<label>Select <select data-choose="kind"><option value="time">in time</option><option value="frequency">in frequency</option>\
<option value="state">in state</option></select></label>
<label>from <input type="number" step="any" data-choose="low"></label>
<label>to <input type="number" step="any" data-choose="high"></label> <span data-say="unit"></span>
<button type="submit">Mark</button> <button type="button" data-do="clear">Clear</button>
<button type="button" data-do="csv">Signals as CSV</button>
</form>
<p class="selected js" data-say="selection" aria-live="polite"></p>
</div>"""
