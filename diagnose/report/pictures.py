"""The pictures, as SVG whose colours are CSS variables of the page: one drawing, legible in light, in dark and on paper."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from diagnose.report.curves import blank, envelope, worst_stretch
from diagnose.report.figures import number, percent, power, unit
from diagnose.result import MapResult, MapVariable, Mismatch, Share, StateShare, Traces

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["load", "spectrum", "states", "time", "torque_map"]

# drawn colour -> the variable that replaces it; the drawn values only have to differ
INK, MUTED, GRID, PAPER = "#010101", "#020202", "#030303", "#040404"
MEASURED, NOMINAL, REFITTED, CORRECTED, BAND, MAPPED = "#050505", "#060606", "#070707", "#080808", "#090909", "#0a0a0a"
_VARIABLES = {
    INK: "ink", MUTED: "muted", GRID: "grid", PAPER: "paper", MEASURED: "measured",
    NOMINAL: "nominal", REFITTED: "refitted", CORRECTED: "corrected", BAND: "band", MAPPED: "mapped",
}  # fmt: skip
_WIDTH = 10.6
_WORTH = 0.01
_STYLE: Any = {
    "svg.fonttype": "none", "svg.hashsalt": "simgap", "font.size": 10, "axes.titlesize": 10, "axes.labelsize": 10,
    "xtick.labelsize": 9, "ytick.labelsize": 9, "legend.fontsize": 9.5, "text.color": INK, "axes.labelcolor": INK,
    "axes.edgecolor": MUTED, "xtick.color": MUTED, "ytick.color": MUTED, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "grid.color": GRID, "grid.linewidth": 0.7, "axes.grid": True, "axes.axisbelow": True, "axes.facecolor": "none",
    "figure.facecolor": "none", "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
    "lines.solid_joinstyle": "round", "path.simplify": False, "axes.linewidth": 0.8, "axes.unicode_minus": True,
    "axes.titlelocation": "left",
}  # fmt: skip


def _figure(height: float) -> Figure:
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, height), dpi=72)
    FigureCanvasSVG(figure)
    return figure


def _svg(figure: Figure, name: str, alt: str) -> str:
    """The drawing as an <svg> element: page colours, the page's font, ids of its own, a title for those who do not see it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.S)
    text = re.sub(r'<g id="[^"]*">', "<g>", text)
    text = re.sub(r'(id="|href="#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r' d="([^"]*)"', lambda m: f' d="{_short(m[1])}"', text)
    text = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", text)
    text = re.sub(r"#(0[1-9a])\1\1", lambda m: f"var(--{_VARIABLES[m[0]]})", text)
    label = alt.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    box = re.search(r'viewBox="[^"]*"', text)
    assert box is not None
    body = text[text.index(">") + 1 :]
    return f'<svg {box[0]} role="img" aria-label="{label}" xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">{body}'


def _short(path: str) -> str:
    """Coordinates to a tenth of a point, in as few characters."""
    rounded = re.sub(r"-?\d+\.\d+", lambda m: f"{float(m[0]):.1f}".removesuffix(".0"), path)
    return re.sub(r"\s+", " ", rounded).strip()


def _style() -> Any:
    import matplotlib as mpl

    return mpl.rc_context(_STYLE)


def load() -> None:
    """Load what draws, fonts and all, by drawing once."""
    with _style():
        figure = _figure(2.0)
        axes = figure.add_subplot()
        axes.loglog([1.0, 2.0], [1.0, 2.0], label="$10^{-1}$")
        _legend(figure, axes)
        _svg(figure, "load", "")


def _legend(figure: Figure, axes: Axes, y: float = 1.0) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="upper left", bbox_to_anchor=(0.06, y), ncols=len(labels), handlelength=2.2, columnspacing=1.6
    )


def time(t: Traces, channel: str, channel_unit: str, found: bool, noise: bool, name: str) -> str:
    """Measured and predicted over time, the error below; at the right the stretch where the refitted model is worst.

    ``noise``: the noise level of the channel is known, and drawn as a band."""
    u = unit(channel_unit)
    zoom = worst_stretch(t)
    alt = (
        f"{channel} of {t.source} over time, measured and predicted, with the prediction errors below; "
        f"at the right the stretch from {t.time[zoom][0]:.4g} to {t.time[zoom][-1]:.4g} s where the refitted "
        "nominal model errs most"
    )
    with _style():
        figure = _figure(4.9)
        grid = figure.add_gridspec(
            2,
            2,
            width_ratios=(1.7, 1),
            height_ratios=(1.35, 1),
            left=0.075,
            right=0.985,
            bottom=0.1,
            top=0.875,
            wspace=0.13,
            hspace=0.14,
        )
        top, bottom = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
        top_zoom, bottom_zoom = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
        everything = slice(0, len(t.time))
        for axes, part, columns in ((top, everything, 550), (top_zoom, zoom, 500)):
            x, wide = t.time[part], part is everything
            axes.plot(*envelope(x, t.measured[part], columns), color=MEASURED, linewidth=1.0 if wide else 3.2, label="measured")
            if t.nominal is not None:
                axes.plot(*envelope(x, t.nominal[part], columns), ":", color=NOMINAL, linewidth=1.1, label="nominal as given")
            axes.plot(
                *envelope(x, t.refitted[part], columns),
                color=REFITTED,
                linewidth=1.1,
                label="nominal refitted",
            )
            if found:
                axes.plot(*envelope(x, t.corrected[part], columns), color=CORRECTED, linewidth=1.0, label="corrected")
            if t.mapped is not None:
                axes.plot(*envelope(x, t.mapped[part], columns), color=MAPPED, linewidth=1.0, label="with the map")
            _limits(axes, (t.measured[part], t.refitted[part]))
        errors = [(blank(t.measured - t.refitted, t.counted), REFITTED)]
        if found:
            errors.append((blank(t.measured - t.corrected, t.counted), CORRECTED))
        if t.mapped is not None:
            errors.append((blank(t.measured - t.mapped, t.counted), MAPPED))
        for axes, part, columns in ((bottom, everything, 550), (bottom_zoom, zoom, 500)):
            if noise and np.isfinite(t.sigma) and t.sigma > 0:
                for edge in (-2 * t.sigma, 2 * t.sigma):
                    axes.axhline(edge, color=MUTED, linewidth=0.7, linestyle=(0, (4, 3)), zorder=4)
            for e, colour in errors:
                axes.plot(*envelope(t.time[part], e[part], columns), color=colour, linewidth=0.9)
            _limits(axes, [e[part] for e, _ in errors])
            axes.set_xlabel("time [s]")
        for axes, part in ((top, everything), (bottom, everything), (top_zoom, zoom), (bottom_zoom, zoom)):
            axes.set_xlim(t.time[part][0], t.time[part][-1])
            axes.yaxis.set_major_locator(_ticks(5))
            axes.xaxis.set_major_locator(_ticks(7 if part is everything else 4))
            _uncounted(axes, t.time[part], t.counted[part])
        for axes in (top, bottom):
            axes.axvspan(t.time[zoom][0], t.time[zoom][-1], facecolor="none", edgecolor=INK, linewidth=0.9, zorder=5)
        for axes in (top, top_zoom):
            axes.tick_params(labelbottom=False)
        top.set_ylabel(f"{channel} [{u}]")
        bottom.set_ylabel(f"error [{u}]")
        top_zoom.set_title("where the refitted nominal errs most")
        figure.align_ylabels([top, bottom])
        _legend(figure, top_zoom)
        return _svg(figure, name, alt)


def _ticks(count: int) -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(count, steps=[1, 2, 2.5, 5, 10])


def _limits(axes: Axes, curves: Iterable[np.ndarray]) -> None:
    """Vertical limits by what is judged; a nominal model that runs away does not squeeze the rest."""
    values = np.concatenate([c[np.isfinite(c)] for c in curves])
    if len(values):
        low, high = float(np.min(values)), float(np.max(values))
        margin = 0.06 * (high - low) or 1.0
        axes.set_ylim(low - margin, high + margin)


def _uncounted(axes: Axes, x: np.ndarray, counted: np.ndarray) -> None:
    """Stretches that no model is judged on, greyed when they are few and long enough to be seen."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], counted, [True]]).astype(int)))
    width = x[-1] - x[0]
    stretches = [(x[a], x[min(b, len(x) - 1)]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    for a, b in stretches:
        if b - a > 0.004 * width and len(stretches) < 60:
            axes.axvspan(a, b, color=GRID, alpha=0.5, linewidth=0, zorder=0.3)


def spectrum(
    m: Mismatch, left: np.ndarray | None, channel: str, channel_unit: str, name: str, *, bands: bool = True
) -> str | None:
    """Spectral density of what is measured, of the errors and of the noise; None when there is no spectrum.

    ``left``: density of what the corrected model leaves, at the frequencies of ``m.spectrum``. ``bands``: shade those that hold
    most of the error.
    """
    f, residual, noise, output = (np.asarray(a, float) for a in m.spectrum)
    keep = f > 0
    if np.count_nonzero(keep) < 3:
        return None
    u = unit(channel_unit)
    strongest = "; ".join(f"{s.low:.3g} to {s.high:.3g} Hz {percent(s.share)}" for s in m.frequency[:3])
    alt = "Spectral density of the measured signal, of the prediction errors and of the noise over frequency"
    with _style():
        figure = _figure(3.5)
        axes = figure.add_axes((0.075, 0.15, 0.905, 0.7))
        curves = [(output, MEASURED, "-", 2.4, f"measured {channel}"), (residual, REFITTED, "-", 1.3, "error, nominal refitted")]
        if left is not None:
            curves.append((left, CORRECTED, "-", 1.3, "error, corrected"))
        if np.any(noise[keep] > 0):
            curves.append((noise, INK, "--", 1.1, "noise"))
        for y, colour, style, width, label in curves:
            axes.loglog(f[keep], np.where(y[keep] > 0, y[keep], np.nan), style, color=colour, linewidth=width, label=label)
        axes.set_xlim(f[keep][0], f[keep][-1])
        _decades(axes)
        if bands:
            _bands(axes, m.frequency)
        axes.grid(True, which="major")
        axes.set_xlabel("frequency [Hz]")
        axes.set_ylabel(f"density [{f'({u})' if len(u) > 1 else u}²/Hz]" if u else "density [1/Hz]")
        _legend(figure, axes)
        return _svg(figure, name, f"{alt}. Strongest bands: {strongest}" if strongest else alt)


def _decades(axes: Axes) -> None:
    """Ticks at the decades only, labelled without mathematical typesetting."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for axis in (axes.xaxis, axes.yaxis):
        low, high = np.log10(axis.get_view_interval())
        axis.set_major_locator(LogLocator(numticks=40 if high - low < 8 else 8))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda x, _: power(float(np.log10(x)))))


def _bands(axes: Axes, shares: Sequence[Share]) -> None:
    """The bands that hold most of the error, shaded; labelled when their labels do not meet."""
    low, high = axes.get_xlim()
    used: list[float] = []
    for s in shares[:3]:
        a, b = max(s.low, low), min(max(s.high, low), high)
        if not b > a:
            continue
        axes.axvspan(a, b, color=BAND, linewidth=0, zorder=0.4)
        at = float(np.sqrt(a * b))
        if s.share >= 0.03 and all(abs(np.log(at / other)) > 0.08 * np.log(high / low) for other in used):
            used.append(at)
            axes.text(at, 1.005, percent(s.share), transform=axes.get_xaxis_transform(), ha="center", va="bottom", fontsize=9)


def states(shares: Sequence[StateShare], torque_unit: str, name: str) -> str | None:
    """Disturbance torque over the states that explain most of it, with two standard errors; None when there is none to draw."""
    drawn = [s for s in shares if len(s.x) > 1 and s.share >= _WORTH][:3]
    if not drawn:
        return None
    u = unit(torque_unit)
    alt = "Torque at the motor that would close the gap, over " + ", over ".join(
        f"{s.state} (explains {percent(s.share)})" for s in drawn
    )
    with _style():
        figure = _figure(3.1)
        grid = figure.add_gridspec(1, max(2, len(drawn)), left=0.075, right=0.985, bottom=0.17, top=0.89, wspace=0.1)
        low = min(float(np.min(s.y - 2 * s.error)) for s in drawn)
        high = max(float(np.max(s.y + 2 * s.error)) for s in drawn)
        margin = 0.08 * (high - low) or 1.0
        for i, s in enumerate(drawn):
            axes = figure.add_subplot(grid[0, i])
            axes.axhline(0, color=MUTED, linewidth=0.8)
            x, x_unit = _scaled(s.x, s.unit)
            axes.fill_between(x, s.y - 2 * s.error, s.y + 2 * s.error, color=BAND, linewidth=0)
            axes.plot(x, s.y, "o-", color=REFITTED, linewidth=1.4, markersize=3.6, markeredgewidth=0)
            axes.set_title(f"explains {percent(s.share)}")
            axes.set_xlabel(f"{s.state} [{x_unit}]" if x_unit else s.state)
            _panel(axes, (low - margin, high + margin), None if i else f"disturbance [{u}]")
        return _svg(figure, name, alt)


def _panel(axes: Axes, limits: tuple[float, float], label: str | None) -> None:
    """One of several panels beside each other with the same limits; the first one alone is labelled."""
    axes.set_ylim(*limits)
    axes.xaxis.set_major_locator(_ticks(5))
    axes.yaxis.set_major_locator(_ticks(6))
    if label is None:
        axes.tick_params(labelleft=False)
    else:
        axes.set_ylabel(label)


def _scaled(x: np.ndarray, unit_text: str) -> tuple[np.ndarray, str]:
    """A state in thousandths of its unit when it is that small: mrad, mm."""
    small = unit_text in ("rad", "m") and float(np.max(np.abs(x))) < 0.05
    return (1e3 * x, f"m{unit_text}") if small else (x, unit(unit_text))


def torque_map(m: MapResult, name: str) -> str:
    """The map with its 95 % bands over its first variable, where data come by; of two, at three values of the second."""
    u = unit(m.unit)
    first = m.variables[0]
    two = len(m.variables) == 2
    count = len(m.variables[1].grid) if two else 1
    cuts = [round(q * (count - 1)) for q in (0.15, 0.5, 0.85)] if two else [0]
    seen = m.seen.reshape(len(first.grid), -1)
    if two:  # three values that the data reach
        reached = np.flatnonzero(seen.sum(axis=0) > 2)
        cuts = [int(reached[round(q * (len(reached) - 1))]) for q in (0.15, 0.5, 0.85)] if len(reached) else cuts
    drawn = [np.where(seen, a.reshape(seen.shape), np.nan) for a in (m.low, m.values, m.high)]
    low, high = float(np.nanmin(drawn[0][:, cuts])), float(np.nanmax(drawn[2][:, cuts]))
    margin = 0.08 * (high - low) or 1.0
    over = " and ".join(v.name for v in m.variables)
    with _style():
        figure = _figure(3.1)
        grid = figure.add_gridspec(1, max(2, len(cuts)), left=0.075, right=0.985, bottom=0.17, top=0.89, wspace=0.1)
        for i, cut in enumerate(cuts):
            axes = figure.add_subplot(grid[0, i])
            axes.axhline(0, color=MUTED, linewidth=0.8)
            x, x_unit = _scaled(first.grid, first.unit)
            below, middle, above = (a[:, cut] for a in drawn)
            axes.fill_between(x, below, above, color=BAND, linewidth=0)
            axes.plot(x, middle, color=MAPPED, linewidth=1.6)
            if two:
                axes.set_title(_cut(m.variables[1], cut))
            axes.set_xlabel(f"{first.name} [{x_unit}]" if x_unit else first.name)
            axes.set_xlim(x[0], x[-1])
            _panel(axes, (low - margin, high + margin), None if i else f"map [{u}]")
        return _svg(figure, name, f"Torque map over {over}, with its 95 % bands")


def _cut(variable: MapVariable, index: int) -> str:
    x, u = _scaled(variable.grid, variable.unit)
    return f"at {variable.name} {number(float(x[index]), 3)} {u}".rstrip()
