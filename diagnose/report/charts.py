"""The plots of a diagnosis: recordings beside models, spectra, the disturbance over states, a torque map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnose.report.curves import blank, psd, worst_stretch
from diagnose.report.figures import number, percent, unit
from diagnose.report.plots import Axis, Band, Chart, Explorer, Line, Panel, Signals, Span
from diagnose.result import Diagnosis, MapResult, MapVariable, Mismatch, StateShare, Traces

__all__ = ["COLOURS", "NAMES", "explorer_of", "map_chart", "recording_chart", "spectrum_chart", "states_chart"]

NAMES = {
    "nominal": "nominal, as given",
    "refitted": "nominal, refitted",
    "corrected": "corrected",
    "mapped": "with the torque map",
}
COLOURS = {"nominal": ("nominal", "dot"), "refitted": ("refitted", ""), "corrected": ("corrected", ""), "mapped": ("mapped", "")}
_SHOWN_STATES = 0.01  # least share that a state explains, for it to be drawn
_MOST_PRINTED = 4  # recordings with a picture for print


def explorer_of(d: Diagnosis) -> Explorer | None:
    """All recordings with the models on them; None where no model was run. Pictures for print of the first few."""
    recordings = tuple(_signals(d, t) for t in sorted(d.traces, key=lambda t: t.role != "estimation"))
    if not recordings:
        return None
    first = recordings[0].models
    error_of = "refitted" if d.findings or "corrected" not in first else "corrected"
    u = unit(d.unit)
    printed = _printed(recordings)
    charts = tuple(recording_chart(s, d.channel, u, error_of, f"t{i}") for i, s in enumerate(printed))
    return Explorer("recordings", d.channel, u, recordings, NAMES, COLOURS, error_of if error_of in first else "refitted", charts)


def _printed(recordings: Sequence[Signals]) -> list[Signals]:
    """Some estimation recordings and at least one held-out one, if there is one."""
    fitted = [s for s in recordings if s.role == "estimation"][: _MOST_PRINTED - 1]
    return fitted + [s for s in recordings if s.role != "estimation"][: _MOST_PRINTED - len(fitted)]


def _signals(d: Diagnosis, t: Traces) -> Signals:
    models: dict[str, np.ndarray] = {} if t.nominal is None else {"nominal": t.nominal}
    if d.findings:
        models |= {"refitted": t.refitted, "corrected": t.corrected}
    elif np.array_equal(t.refitted, t.corrected) or (t.nominal is not None and np.array_equal(t.nominal, t.corrected)):
        models["refitted"] = t.refitted
    else:  # nothing was added: the corrected file is the refitted model, as MuJoCo steps it
        models["corrected"] = t.corrected
    if t.mapped is not None:
        models["mapped"] = t.mapped
    order = sorted(t.states, key=lambda name: (name == "angle") - (name == "velocity"))
    states = {name: (t.states[name][0], unit(t.states[name][1])) for name in order}
    return Signals(t.source, t.role, t.time, t.measured, models, states, t.counted, t.sigma)


def recording_chart(s: Signals, channel: str, u: str, error_of: str, key: str) -> Chart:
    """Measured and predicted over time, errors below; at the right the stretch where the model ``error_of`` errs most."""
    counted = np.ones(len(s.time), bool) if s.counted is None else s.counted
    zoom = worst_stretch(s.time, s.measured, s.models.get(error_of, s.measured), counted)
    ends = float(s.time[zoom][0]), float(s.time[zoom][-1])
    errors = {k: blank(s.measured - y, counted) for k, y in s.models.items()}
    top_limits = _limits([s.measured, *(y for k, y in s.models.items() if k != "nominal" or len(s.models) == 1)])
    bottom_limits = _limits([e for k, e in errors.items() if k != "nominal" or len(errors) == 1])
    tops, bottoms = [], []
    for part, title in ((slice(0, len(s.time)), ""), (zoom, "where the error is largest")):
        t = s.time[part]
        wide = not title
        x = Axis("time", "s", limits=(float(t[0]), float(t[-1])))
        models = [
            Line(NAMES.get(k, k), t, y[part], COLOURS[k][0], 1.0 if wide else 1.6, COLOURS[k][1]) for k, y in s.models.items()
        ]
        top = (Line(f"measured {channel}", t, s.measured[part], "measured", 1.6 if wide else 3.2), *models)
        bottom = [Line("", t, e[part], COLOURS[k][0], 0.9, COLOURS[k][1]) for k, e in errors.items()]
        if np.isfinite(s.sigma) and s.sigma > 0:
            edge = np.array([t[0], t[-1]])
            bottom += [Line("", edge, np.full(2, 2 * sign * s.sigma), "muted", 0.8, "dash") for sign in (-1.0, 1.0)]
        spans = (Span(*ends),) if wide else ()
        tops.append(Panel(x, Axis(channel, u, limits=top_limits), top, spans, title))
        bottoms.append(Panel(x, Axis("error", u, limits=bottom_limits), tuple(bottom), spans))
    alt = (
        f"{channel.capitalize()} of {s.source} ({s.role}) over time, measured and predicted, with the "
        f"prediction errors below; at the right the stretch from {ends[0]:.4g} to {ends[1]:.4g} s where the error is largest"
    )
    return Chart(key, alt, (tuple(tops), tuple(bottoms)), 350, (1.7, 1.0))


def _limits(curves: Sequence[np.ndarray]) -> tuple[float, float]:
    """Vertical limits, by the samples that count: a nominal model that diverges does not set the scale."""
    values = np.concatenate([c[np.isfinite(c)] for c in curves])
    if not len(values):
        return -1.0, 1.0
    low, high = float(np.min(values)), float(np.max(values))
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def spectrum_chart(d: Diagnosis, m: Mismatch, t: Traces | None, key: str, *, bands: bool) -> Chart | None:
    """Densities of what is measured, of the errors and of the noise; None when there is no spectrum.

    ``bands``: shade those that hold most of the error above the noise.
    """
    f, residual, noise, output = (np.asarray(a, float) for a in m.spectrum)
    keep = f > 0
    if np.count_nonzero(keep) < 3:
        return None
    u = unit(d.unit)
    curves = [
        (f"measured {d.channel}", output, "measured", 2.4, ""),
        (f"error, {NAMES['refitted']}", residual, "refitted", 1.3, ""),
    ]
    left = _density_left(m, t) if d.findings else None
    if left is not None:
        curves.append((f"error, {NAMES['corrected']}", left, "corrected", 1.3, ""))
    if np.any(noise[keep] > 0):
        curves.append(("noise", noise, "ink", 1.1, "dash"))
    lines = tuple(
        Line(name, f[keep], np.where(y[keep] > 0, y[keep], np.nan), colour, width, dash)
        for name, y, colour, width, dash in curves
    )
    low, high = float(f[keep][0]), float(f[keep][-1])
    spans = tuple(
        Span(max(s.low, low), min(s.high, high), percent(s.share) if s.share >= 0.03 else "")
        for s in m.frequency[:3]
        if bands and min(s.high, high) > max(s.low, low)
    )
    strongest = "; ".join(f"{s.low:.3g} to {s.high:.3g} Hz {percent(s.share)}" for s in m.frequency[:3])
    alt = "Spectral density of the measured signal, of the prediction errors and of the noise over frequency"
    y = Axis("density", f"{f'({u})' if len(u) > 1 else u}²/Hz" if u else "1/Hz", log=True)
    panel = Panel(Axis("frequency", "Hz", log=True, limits=(low, high)), y, lines, spans)
    return Chart(key, f"{alt}. Strongest bands: {strongest}" if strongest else alt, ((panel,),), 260)


def _density_left(m: Mismatch, t: Traces | None) -> np.ndarray | None:
    """Spectral density of what the corrected model leaves, at the frequencies of the mismatch's spectrum."""
    bins = len(m.spectrum[0])
    density = psd(t.measured - t.corrected, float(np.median(np.diff(t.time))), bins) if t is not None else None
    return density[1] if density is not None and len(density[1]) == bins else None


def states_chart(shares: Sequence[StateShare], torque_unit: str, key: str) -> Chart | None:
    """Disturbance torque over the states that explain most of it, with two standard errors; None when there is none to draw."""
    drawn = [s for s in shares if len(s.x) > 1 and s.share >= _SHOWN_STATES][:3]
    if not drawn:
        return None
    u = unit(torque_unit)
    limits = _limits([s.y + sign * 2 * s.error for s in drawn for sign in (-1, 1)])
    panels = []
    for s in drawn:
        x, x_unit = _scaled(s.x, s.unit)
        marks = (
            Band("two standard errors", x, s.y - 2 * s.error, s.y + 2 * s.error),
            Line("disturbance torque", x, s.y, "refitted", 1.4, points=True),
        )
        panels.append(
            Panel(Axis(s.state, x_unit), Axis("disturbance", u, limits=limits), marks, (), f"explains {percent(s.share)}")
        )
    alt = "Torque at the motor that would close the gap, over " + ", over ".join(
        f"{s.state} (explains {percent(s.share)})" for s in drawn
    )
    return Chart(key, alt, (tuple(panels),), 240)


def _scaled(x: np.ndarray, unit_text: str) -> tuple[np.ndarray, str]:
    """A state in thousandths of its unit when it is that small: mrad, mm."""
    small = unit_text in ("rad", "m") and float(np.max(np.abs(x))) < 0.05
    return (1e3 * x, f"m{unit_text}") if small else (x, unit(unit_text.replace("/s/s", "/s^2")))


def map_chart(m: MapResult, key: str) -> Chart:
    """The map with its 95 % bands over its first variable, where data come by; of two, at three values of the second."""
    first = m.variables[0]
    seen = m.seen.reshape(len(first.grid), -1)
    two = len(m.variables) == 2
    cuts = _cuts(seen) if two else [0]
    low, middle, high = (np.where(seen, a.reshape(seen.shape), np.nan) for a in (m.low, m.values, m.high))
    limits = _limits([low[:, cuts], high[:, cuts]])
    x, x_unit = _scaled(first.grid, first.unit)
    axis = Axis(first.name, x_unit, limits=(float(x[0]), float(x[-1])))
    panels = tuple(
        Panel(
            axis, Axis("map", unit(m.unit), limits=limits),
            (Band("95 % interval", x, low[:, cut], high[:, cut]), Line("torque map", x, middle[:, cut], "mapped", 1.6)),
            (), _cut(m.variables[1], cut) if two else "",
        )
        for cut in cuts
    )  # fmt: skip
    over = " and ".join(v.name for v in m.variables)
    return Chart(key, f"Torque map over {over}, with its 95 % bands", (panels,), 240)


def _cuts(seen: np.ndarray) -> list[int]:
    """Three values of the second variable that the data reach."""
    reached = np.flatnonzero(seen.sum(axis=0) > 2)
    at = reached if len(reached) else np.arange(seen.shape[1])
    return list(dict.fromkeys(int(at[round(q * (len(at) - 1))]) for q in (0.15, 0.5, 0.85)))


def _cut(variable: MapVariable, index: int) -> str:
    x, u = _scaled(variable.grid, variable.unit)
    return f"at {variable.name} {number(float(x[index]), 3)} {u}".rstrip()
