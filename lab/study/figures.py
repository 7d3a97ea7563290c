"""The study's figures: black-and-white safe, the report's line styles, each with its data as CSV."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lab.study.cell import GRID_HZ, Result
from lab.study.claims import physical_features
from lab.study.damping import DampingStudy
from lab.study.ledger import FAMILIES, Entry
from lab.study.variants import Variant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Curve", "Picture", "bode_figure", "damping_figure", "files", "ladder_figure", "map_figure", "time_figure"]

DASH, DOT, DASH_DOT = (0, (6, 2.2)), (0, (1, 1.6)), (0, (6, 2, 1, 2))
_STYLE: Any = {
    "font.family": "serif", "font.serif": ["STIXGeneral", "DejaVu Serif"], "mathtext.fontset": "stix", "font.size": 9,
    "axes.linewidth": 0.6, "xtick.direction": "in", "ytick.direction": "in", "pdf.fonttype": 42, "svg.fonttype": "none",
}  # fmt: skip


@dataclass(frozen=True)
class Curve:
    """One line of a Bode figure."""

    label: str
    result: Result
    style: Any = "-"
    grey: str = "black"
    width: float = 1.1


@dataclass(frozen=True)
class Picture:
    """A figure with its data: columns of equal length by name."""

    name: str
    caption: str
    figure: Figure
    data: Mapping[str, np.ndarray]


def _figure(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _context() -> Any:
    import matplotlib as mpl

    return mpl.rc_context(_STYLE)


def bode_figure(
    name: str,
    caption: str,
    columns: Sequence[tuple[str, float, Sequence[Curve]]],
    note: str = "",
    exact: tuple[str, np.ndarray] | None = None,
) -> Picture:
    """Magnitude, the resonances enlarged, and phase; one column per pipeline: (title, edge of the excitation [Hz], curves).

    What lies outside the excitation is grey. ``exact``: label and complex response on GRID_HZ, drawn as small rings.
    """
    data: dict[str, np.ndarray] = {"frequency_hz": GRID_HZ}
    with _context():
        figure = _figure(3.6 * len(columns) + 0.2, 6.6)
        grid = figure.subplots(3, len(columns), sharey="row", squeeze=False, height_ratios=(4, 4, 3))
        for j, (title, high, curves) in enumerate(columns):
            for axis in grid[:, j]:
                axis.axvspan(high, 60.0, color="0.92", linewidth=0, zorder=0)
            if exact is not None:
                _rings(grid[:, j], exact)
            family = ("report", "better")[j]
            for i, c in enumerate(curves):
                line = {"linestyle": c.style, "color": c.grey, "linewidth": c.width, "zorder": 3 + i}
                if c.result.void:
                    grid[0][j].text(0.03, 0.05 + 0.09 * i, f"{c.label}: no model", transform=grid[0][j].transAxes, fontsize=7)
                    grid[0][j].plot([], [], label=c.label, **line)
                    continue
                magnitude, phase = np.asarray(c.result.magnitude_db), np.asarray(c.result.phase_deg)
                for axis, values in zip(grid[:, j], (magnitude, magnitude, phase), strict=True):
                    axis.plot(GRID_HZ, values, label=c.label, **line)
                key = f"{family}: {c.label}".replace(",", "")
                data[f"{key} [dB]"], data[f"{key} [deg]"] = magnitude, phase
            grid[0][j].set_title(title, fontsize=8.5)
            _dress(grid[:, j], first=j == 0)
        if exact is not None:
            data["linear exact [dB]"] = 20 * np.log10(np.abs(exact[1]))
            data["linear exact [deg]"] = np.degrees(np.unwrap(np.angle(exact[1])))
        handles, labels = grid[0][0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside lower center", ncols=min(5, len(labels)), fontsize=8, frameon=False, handlelength=3.2
        )
        figure.suptitle(caption + (f"\n{note}" if note else ""), fontsize=9.5)
    return Picture(name, caption, figure, data)


def _rings(axes: np.ndarray, exact: tuple[str, np.ndarray]) -> None:
    magnitude, phase = 20 * np.log10(np.abs(exact[1])), np.degrees(np.unwrap(np.angle(exact[1])))
    steps = ((14, magnitude), (5, magnitude), (14, phase))
    for axis, (step, values) in zip(axes, steps, strict=True):
        axis.plot(GRID_HZ[::step], values[::step], "o", markersize=2.4, markerfacecolor="white", markeredgewidth=0.5,
                  color="0.25", zorder=2, label=exact[0])  # fmt: skip


def _dress(axes: np.ndarray, first: bool) -> None:
    top, middle, bottom = axes
    ticks = [1, 2, 5, 10, 20, 30, 50]
    for axis in (top, bottom):
        axis.set_xscale("log")
        axis.set_xlim(1.0, 55.0)
        axis.set_xticks(ticks, [str(t) for t in ticks])
        axis.minorticks_off()
    middle.set_xlim(13.0, 41.0)
    top.set_ylim(-32, 62)
    middle.set_ylim(-26, 46)
    bottom.set_ylim(-560, 200)
    bottom.set_yticks(range(-540, 181, 90))
    bottom.set_xlabel("frequency [Hz]")
    for axis in axes:
        axis.grid(True, color="0.85", linewidth=0.4)
        axis.set_axisbelow(True)
    top.text(0.988, 0.02, "not excited", transform=top.transAxes, ha="right", va="bottom", fontsize=6.5, color="0.35")
    middle.text(0.012, 0.97, "enlarged, linear axis", transform=middle.transAxes, ha="left", va="top", fontsize=6.5, color="0.35")
    if first:
        top.set_ylabel("magnitude [dB re rad/s/Nm]")
        middle.set_ylabel("magnitude [dB]")
        bottom.set_ylabel("phase [deg]")


def time_figure(name: str, caption: str, time: np.ndarray, torque: np.ndarray, velocity: np.ndarray) -> Picture:
    """Input and output: the whole record, and a cut in which single oscillations can be seen."""
    with _context():
        figure = _figure(7.4, 3.8)
        grid = figure.subplots(2, 2, sharex="col", sharey="row", width_ratios=(2, 1))
        cut = time[-1] * 0.62
        for j, (low, high) in enumerate(((0.0, float(time[-1])), (cut, cut + 1.0))):
            shown = (time >= low) & (time <= high)
            for axis, signal in zip(grid[:, j], (torque, velocity), strict=True):
                axis.plot(time[shown], signal[shown], color="black", linewidth=0.45 if j == 0 else 0.8)
                axis.grid(True, color="0.88", linewidth=0.4)
                axis.set_xlim(low, high)
            grid[1, j].set_xlabel("time [s]")
        for axis in grid[:, 0]:
            axis.axvspan(cut, cut + 1.0, color="0.85", linewidth=0, zorder=0)
        grid[0, 0].set_ylabel(r"motor torque $\tau$ [Nm]")
        grid[1, 0].set_ylabel(r"motor velocity $\dot\theta_m$ [rad/s]")
        grid[0, 1].set_title("the grey second", fontsize=8.5)
        figure.suptitle(caption, fontsize=9.5)
    return Picture(name, caption, figure, {"time_s": time, "torque_Nm": torque, "velocity_rad_s": velocity})


def ladder_figure(name: str, caption: str, rows: Sequence[Mapping[str, Any]]) -> Picture:
    """Second peak and second mode as found, step by step from the report's pipeline to the better one, and the error of G.

    Each row: ``step``, ``peak_hz`` and ``mode_hz`` (one per noise seed), ``error_30``, ``error_36`` (medians, relative).
    """
    exact = physical_features()["second_peak"].hz
    mode = next((r["exact_mode_hz"] for r in rows), 32.9)
    with _context():
        figure = _figure(7.4, 2.9)
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
        y = -np.arange(len(rows), dtype=float)
        left.axvline(exact, color="0.35", linewidth=0.8)
        left.axvline(mode, color="0.35", linewidth=0.8, linestyle=DASH)
        top = max([v for r in rows for v in r["peak_hz"] if v is not None] + [exact]) + 0.6
        for i, row in enumerate(rows):
            peaks = [v for v in row["peak_hz"] if v is not None]
            modes = [v for v in row["mode_hz"] if v is not None]
            left.plot(
                peaks, np.full(len(peaks), y[i] + 0.12), "o", color="black", markersize=4, markerfacecolor="white", zorder=3
            )
            left.plot(modes, np.full(len(modes), y[i] - 0.14), "x", color="black", markersize=4, zorder=3)
            missing = len(row["peak_hz"]) - len(peaks)
            if missing:
                left.text(
                    top, y[i], f"{missing} of {len(row['peak_hz'])} without", ha="right", va="center", fontsize=6.5, color="0.3"
                )
        left.plot([], [], "o", color="black", markersize=4, markerfacecolor="white", label="peak of the magnitude")
        left.plot([], [], "x", color="black", markersize=4, label="natural frequency of the pole pair")
        left.plot([], [], color="0.35", linewidth=0.8, label=f"exact peak {exact:.2f} Hz")
        left.plot([], [], color="0.35", linewidth=0.8, linestyle=DASH, label=f"exact mode {mode:.2f} Hz")
        left.set_yticks(y, [r["step"] for r in rows])
        left.set_ylim(y[-1] - 0.6, 0.6)
        left.set_xlabel("second peak [Hz], five noise seeds")
        for key, marker, label in (("error_30", "s", "1 to 30 Hz"), ("error_36", "D", "1 to 36 Hz")):
            right.plot([100 * r[key] for r in rows], y, marker, color="black", markersize=4,
                       markerfacecolor="black" if key == "error_30" else "white", label=label)  # fmt: skip
        right.set_xscale("log")
        right.set_xlabel("error of G, rms over rms [%]")
        right.legend(loc="lower right", fontsize=7, frameon=False)
        for axis in (left, right):
            axis.grid(True, color="0.9", linewidth=0.4)
            axis.set_axisbelow(True)
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7.5, frameon=False)
        figure.suptitle(caption, fontsize=9.5)
    columns: dict[str, np.ndarray] = {"step": np.array([r["step"].replace(",", "") for r in rows])}
    for s in range(len(rows[0]["peak_hz"])):
        columns[f"peak_hz_seed_{s + 1}"] = np.array([np.nan if r["peak_hz"][s] is None else r["peak_hz"][s] for r in rows])
        columns[f"mode_hz_seed_{s + 1}"] = np.array([np.nan if r["mode_hz"][s] is None else r["mode_hz"][s] for r in rows])
    for key in ("error_30", "error_36", "simulation_percent"):
        columns[key] = np.array([r[key] for r in rows])
    return Picture(name, caption, figure, columns)


def map_figure(name: str, caption: str, entries: Sequence[Entry]) -> Picture:
    """Claims against variants: filled where the criterion is met, open where not, a dash where the variant cannot say."""
    variants: list[Variant] = list(entries[0].answers)
    order = [v for family in FAMILIES for v in variants if v.family == family]
    data: dict[str, np.ndarray] = {"claim": np.array([e.claim.id for e in entries])}
    data["verdict"] = np.array([e.verdict.value for e in entries])
    with _context():
        figure = _figure(0.235 * len(order) + 2.2, 0.21 * len(entries) + 2.2)
        axis = figure.subplots()
        y = -np.arange(len(entries), dtype=float)
        x = np.array([i + (v.family == "better") * 0.9 for i, v in enumerate(order)])
        for i, v in enumerate(order):
            met = [e.answers[v].met for e in entries]
            for want, marker, face, size in ((True, "s", "black", 5.0), (False, "s", "white", 5.0), (None, "_", "0.5", 4.0)):
                at = [k for k, m in enumerate(met) if m is want]
                grey = "0.5" if want is None else "black"
                axis.plot(
                    np.full(len(at), x[i]), y[at], marker, color=grey, markerfacecolor=face, markersize=size, markeredgewidth=0.7
                )
            data[f"{v.family}: {v.changed}".replace(",", "")] = np.array(["" if m is None else str(int(m)) for m in met])
        axis.set_yticks([])
        for k, e in enumerate(entries):
            axis.text(-3.6, y[k], e.claim.id, ha="left", va="center", fontsize=8.5)
            axis.text(-2.5, y[k], e.verdict.value, ha="left", va="center", fontsize=8.5)
            if k % 2:
                axis.axhspan(y[k] - 0.5, y[k] + 0.5, color="0.95", linewidth=0, zorder=0)
        axis.set_xticks(x, [v.changed for v in order], rotation=90, fontsize=7.5)
        axis.xaxis.tick_top()
        axis.tick_params(length=0)
        for family, text in FAMILIES.items():
            mine = x[[v.family == family for v in order]]
            axis.text(float(mine.mean()), y[-1] - 1.1, text, ha="center", va="top", fontsize=8.5)
            axis.hlines(y[-1] - 0.85, mine[0] - 0.4, mine[-1] + 0.4, color="black", linewidth=0.6)
        axis.set_ylim(y[-1] - 2.0, 0.8)
        axis.set_xlim(-3.8, x[-1] + 0.7)
        for spine in axis.spines.values():
            spine.set_visible(False)
        axis.plot([], [], "s", color="black", markersize=5, label="criterion met")
        axis.plot([], [], "s", color="black", markerfacecolor="white", markersize=5, label="not met")
        axis.plot([], [], "_", color="0.5", markersize=5, label="cannot say")
        figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
        figure.suptitle(caption, fontsize=9.5)
    return Picture(name, caption, figure, data)


def damping_figure(name: str, caption: str, study: DampingStudy) -> Picture:
    """The damping that a fit finds on a robot without any, against the delay between its two channels."""
    delay, dg, error = (np.array([m[i] for m in study.mistaken]) for i in range(3))
    with _context():
        figure = _figure(4.6, 3.0)
        axis = figure.subplots()
        axis.axhline(-62.0, color="0.4", linewidth=0.8, linestyle=DASH)
        axis.text(float(delay.max()) * 1e3, -62.0, r"published $d_g = -62$", fontsize=8, ha="right", va="bottom", color="0.2")
        axis.plot(1e3 * delay, dg, "o-", color="black", markersize=3.5, linewidth=1.0, markerfacecolor="white")
        if study.mistaken_for is not None:
            axis.plot(1e3 * study.mistaken_for, -62.0, "o", color="black", markersize=6)
            text = f"{1e3 * study.mistaken_for:.2f} ms".replace("-", "\u2212")
            axis.annotate(text, (1e3 * study.mistaken_for, -62.0), xytext=(8, -14), textcoords="offset points", fontsize=8)
        axis.set_xlabel("velocity late (+) or torque late (\u2212) in the log [ms]")
        axis.set_ylabel(r"$d_g$ that the fit finds [Nms/rad]")
        axis.grid(True, color="0.88", linewidth=0.4)
        figure.suptitle(caption, fontsize=9.5)
    return Picture(name, caption, figure, {"delay_s": delay, "dg_found": dg, "relative_error": error})


def files(picture: Picture, folder: Path) -> dict[Path, str | bytes]:
    """PNG, PDF and CSV under the figure's name in ``folder``, as contents to be written."""
    out: dict[Path, str | bytes] = {}
    with _context():
        for kind, meta in (("png", {"Software": None}), ("pdf", {"CreationDate": None, "Producer": None, "Creator": None})):
            buffer = io.BytesIO()
            picture.figure.savefig(buffer, format=kind, metadata=meta)
            out[folder / f"{picture.name}.{kind}"] = buffer.getvalue()
    names = list(picture.data)
    rows = zip(*(picture.data[n] for n in names), strict=True)
    lines = [",".join(names)]
    lines += [",".join(f"{v:.8g}" if isinstance(v, float | np.floating) else str(v) for v in row) for row in rows]
    out[folder / f"{picture.name}.csv"] = "\n".join(lines) + "\n"
    return out
