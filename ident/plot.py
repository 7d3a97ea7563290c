"""Figures: readable in black and white, every curve told apart by its line style, bands by grey."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ident.bode import Bode
from ident.compare import Comparison
from ident.order import OrderSelection
from ident.polezero import PoleZero
from ident.residuals import ResidualTests, p_text
from ident.spectral import SpectralEstimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_bode", "plot_comparison", "plot_orders", "plot_pole_zero", "plot_residuals"]

STYLES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 3)))
_BAND = "0.82"


def _figure(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plot_bode(
    responses: dict[str, Bode],
    check: SpectralEstimate | None = None,
    excited_hz: tuple[float, float] | None = None,
    unit: str = "",
    level: float = 0.95,
) -> Figure:
    """Magnitude and phase with confidence bands; ``check``: dots of a nonparametric estimate, its coherence below; outside
    ``excited_hz`` is hatched."""
    coherent = check is not None and bool(np.any(np.isfinite(check.coherence)))
    figure = _figure(7.0, 7.2 if coherent else 6.0)
    top, bottom, *rest = figure.subplots(2 + coherent, 1, sharex=True, height_ratios=(3, 2, 1)[: 2 + coherent])
    low_edge = min(float(b.frequency_hz[0]) for b in responses.values())
    high_edge = float(f"{max(float(b.frequency_hz[-1]) for b in responses.values()):.6g}")  # the grid ends just below Nyquist
    if excited_hz is not None:
        low_edge = min(high_edge / 10, max(low_edge, excited_hz[0] / 3))
    limits: list[np.ndarray] = []
    if check is not None:
        keep = check.frequency_hz >= low_edge
        dots = {"color": "0.45", "marker": ".", "markersize": 3.0, "linestyle": "none", "zorder": 1}
        top.plot(check.frequency_hz[keep], check.magnitude_db[keep], label="spectral estimate (no model)", **dots)
    reference, band_label = next(iter(responses.values())), f"{100 * level:g} % band"
    for (name, b), style in zip(responses.items(), _cycle(len(responses)), strict=True):
        shown = b.frequency_hz >= low_edge
        x = b.frequency_hz[shown]
        if np.any(b.magnitude_std > 0):
            lower, upper = (edge[shown] for edge in b.magnitude_db_interval(level))
            sane = b.magnitude_std[shown] < 2.0
            top.fill_between(x, lower, upper, where=sane, color=_BAND, linewidth=0, zorder=0, label=band_label)
            band_label = "_"
            p_low, p_high = (edge[shown] for edge in b.phase_deg_interval(level))
            bottom.fill_between(x, p_low, p_high, where=sane, color=_BAND, linewidth=0, zorder=0)
        top.plot(x, b.magnitude_db[shown], color="black", linestyle=style, linewidth=1.3, label=name, zorder=3)
        bottom.plot(x, b.phase_deg[shown], color="black", linestyle=style, linewidth=1.3, zorder=3)
        limits.append(b.magnitude_db[shown])
    if check is not None:
        keep = (check.frequency_hz >= low_edge) & (check.coherence > 0.5)
        smooth = np.interp(check.frequency_hz, reference.frequency_hz, reference.phase_deg)
        near = smooth + (check.phase_deg - smooth + 180) % 360 - 180
        bottom.plot(check.frequency_hz[keep], near[keep], **dots)
        for axis in rest:
            there = check.frequency_hz >= low_edge
            axis.plot(check.frequency_hz[there], check.coherence[there], color="black", linewidth=0.9)
            axis.set_ylim(0, 1.05)
            axis.set_ylabel("coherence")
    everything = np.concatenate(limits)
    span = max(10.0, float(np.ptp(everything)))
    top.set_ylim(everything.min() - 0.12 * span, everything.max() + 0.15 * span)
    for axis in (top, bottom, *rest):
        axis.set_xscale("log")
        axis.grid(True, which="both", color="0.9", linewidth=0.6)
        axis.set_axisbelow(True)
        if excited_hz is not None:
            for a, z in ((low_edge, excited_hz[0]), (excited_hz[1], high_edge)):
                if z > a * 1.01:
                    axis.axvspan(a, z, facecolor="none", edgecolor="0.75", hatch="////", linewidth=0, zorder=-1)
    if excited_hz is not None and excited_hz[1] < 0.97 * high_edge:
        mark = {"facecolor": "none", "edgecolor": "0.6", "hatch": "////", "linewidth": 0}
        top.fill_between([], [], [], label="input has no power here", **mark)
    top.set_xlim(low_edge, high_edge)
    top.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    top.set_ylabel(f"magnitude [dB{' re ' + unit if unit else ''}]")
    bottom.set_ylabel("phase [deg]")
    (rest or [bottom])[-1].set_xlabel("frequency [Hz]")
    top.legend(loc="best", fontsize=8, framealpha=0.95)
    return figure


def _cycle(count: int) -> list[str | tuple[int, tuple[int, ...]]]:
    return [STYLES[i % len(STYLES)] for i in range(count)]


def plot_residuals(tests: ResidualTests) -> Figure:
    """Autocorrelation and cross-correlation with their bounds."""
    figure = _figure(7.0, 5.0)
    top, bottom = figure.subplots(2, 1)
    for axis, lag, value, bound in (
        (top, np.arange(1, tests.lags + 1), tests.auto[1:], tests.auto_bound),
        (bottom, np.arange(-tests.lags, tests.lags + 1), tests.cross, tests.cross_bound),
    ):
        axis.axhspan(-bound, bound, color=_BAND, linewidth=0, label=f"{100 * tests.level:g} % bound for one lag")
        axis.axhline(0, color="0.5", linewidth=0.8)
        outside = np.abs(value) > bound
        axis.vlines(lag, 0, value, color="black", linewidth=1.0)
        axis.plot(lag[~outside], value[~outside], "o", color="black", markersize=3.5, label="inside")
        if np.any(outside):
            axis.plot(lag[outside], value[outside], "s", color="black", markersize=5.0, markerfacecolor="white", label="outside")
        reach = max(1.6 * bound, 1.15 * float(np.max(np.abs(value))))
        axis.set_ylim(-reach, reach)
        axis.grid(True, color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.legend(loc="upper right", fontsize=8, ncols=3)
    verdict = "white" if tests.white else "not white"
    top.set_title(f"autocorrelation of the residuals: {verdict} (joint {p_text(tests.whiteness_p)})", fontsize=10)
    verdict = "free of past input" if tests.independent else "past input left in them"
    bottom.set_title(f"cross-correlation with the input: {verdict} (joint {p_text(tests.independence_p)})", fontsize=10)
    top.set_xlabel("lag [samples]")
    bottom.set_xlabel("lag [samples]; negative lags tell of feedback")
    return figure


def plot_pole_zero(*sets: PoleZero, level: float = 0.95) -> Figure:
    """Poles (x) and zeros (o) in the z plane with confidence ellipses."""
    figure = _figure(6.0, 6.0)
    axis = figure.subplots()
    turn = np.linspace(0, 2 * np.pi, 361)
    axis.plot(np.cos(turn), np.sin(turn), color="0.6", linewidth=0.8)
    for axis_line in (axis.axhline, axis.axvline):
        axis_line(0, color="0.85", linewidth=0.8, zorder=0)
    reach = 1.15
    for pz, style in zip(sets, _cycle(len(sets)), strict=True):
        for roots, marker in ((pz.poles, "x"), (pz.zeros, "o")):
            for root in roots:
                axis.plot(root.z.real, root.z.imag, marker, color="black", markersize=7, markerfacecolor="none")
                outline = root.ellipse(level)
                if np.max(np.abs(outline - root.z)) < 2.0:
                    axis.plot(outline.real, outline.imag, color="black", linestyle=style, linewidth=0.9)
                if abs(root.z) < 3:
                    reach = max(reach, 1.1 * abs(root.z))
    axis.plot([], [], "x", color="black", label="pole")
    axis.plot([], [], "o", color="black", markerfacecolor="none", label=f"zero ({100 * level:g} % regions outlined)")
    axis.set_xlim(-reach, reach)
    axis.set_ylim(-reach, reach)
    axis.set_aspect("equal")
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    axis.legend(loc="upper left", fontsize=8)
    return figure


def plot_orders(selection: OrderSelection) -> Figure:
    """AIC and BIC of every structure, and below the simulation fit on held-out data (the loss where there are none).

    The best by each is ringed; MATLAB's ``selstruc`` picture.
    """
    figure = _figure(7.5, 5.4)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    choices = sorted(selection.choices, key=lambda c: (c.structure.n_parameters, c.structure.listed))
    x = np.arange(len(choices))

    def draw(axis: Axes, values: np.ndarray, best: int, style: str, marker: str, label: str) -> None:
        axis.plot(x, values, color="black", linestyle=style, marker=marker, markersize=4, linewidth=1, label=label)
        axis.plot(best, values[best], marker=marker, markersize=12, markerfacecolor="none", color="black", linestyle="none")
        axis.grid(True, color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)

    for key, style, marker in (("bic", "-", "o"), ("aic", "--", "s")):
        values = np.array([getattr(c, key) for c in choices])
        draw(top, values - values.min(), int(np.argmin(values)), style, marker, key.upper())
    top.set_yscale("symlog", linthresh=10)
    top.set_ylim(bottom=-3)
    top.set_ylabel("above the smallest")
    top.legend(fontsize=8)
    fits = np.array([np.nan if c.validation_percent is None else c.validation_percent for c in choices])
    if np.any(np.isfinite(fits)):
        draw(bottom, np.maximum(fits, 0.0), int(np.nanargmax(fits)), "-", "D", "held-out")
        bottom.set_ylabel("simulation fit,\nheld-out data [%]")
    else:
        loss = np.array([c.loss for c in choices])
        draw(bottom, loss, int(np.argmin(loss)), "-", "D", "loss")
        bottom.set_yscale("log")
        bottom.set_ylabel("loss (mean of e²)")
    crowded = len(x) > 8
    bottom.set_xticks(x, [" ".join(map(str, c.structure.listed)) for c in choices], rotation=90 if crowded else 0, fontsize=8)
    bottom.set_xlabel(f"orders of {choices[0].structure.name}; ringed: best")
    return figure


def plot_comparison(comparison: Comparison, most: int = 60_000) -> Figure:
    """Measured and modelled output over time, a stretch of it enlarged where it moves most, and the residual.

    At most ``most`` samples are drawn, from the start.
    """
    figure = _figure(7.5, 6.4)
    axes = figure.subplots(3, 1)
    d = comparison.data
    shown = slice(0, min(len(d), most))
    y = np.asarray(d.y)[shown]
    width = int(min(y.size, max(40, y.size // 15)))
    power = np.convolve((y - y.mean()) ** 2, np.ones(width), "valid")
    first = int(np.argmax(power))
    near = slice(first, first + width)
    unit = f"{d.y_name} [{d.y_unit}]" if d.y_unit else d.y_name
    for axis, part in ((axes[0], shown), (axes[1], near)):
        axis.plot(d.time[part], d.y[part], color="0.6", linewidth=2.2 if part is near else 1.0, label="measured")
    kind = "simulated" if comparison.horizon is None else f"predicted {comparison.horizon} samples ahead"
    for name, fit, modelled, style in zip(
        comparison.names, comparison.fit_percent, comparison.outputs, _cycle(len(comparison.names)), strict=True
    ):
        for axis, part, values in ((axes[0], shown, modelled), (axes[1], near, modelled), (axes[2], shown, d.y - modelled)):
            line = {"color": "black", "linestyle": style, "linewidth": 1.0 if part is near else 0.5}
            axis.plot(d.time[part], values[part], label=f"{name}: {fit:.1f} %", **line)
    if np.all(np.isfinite(comparison.outputs)):
        reach = max(1.05 * float(np.max(np.abs(y - y.mean()))), 1e-300)
        axes[2].set_ylim(-reach, reach)
    axes[0].axvspan(d.time[near.start], d.time[near.stop - 1], color="0.85", linewidth=0, zorder=0)
    for axis, title in zip(
        axes, (f"{kind}; grey: enlarged below", "enlarged", "left over, on the scale of the output"), strict=True
    ):
        axis.set_title(title, fontsize=9)
        axis.set_ylabel(unit)
        axis.grid(True, color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.margins(x=0.01)
    axes[1].legend(loc="upper right", fontsize=8, framealpha=0.95)
    axes[2].set_xlabel("time [s]")
    return figure
