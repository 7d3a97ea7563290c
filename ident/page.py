"""The self-contained page ``identification.html``: the verdict in words, the figures, the numbers."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING

import numpy as np

from ident.bode import Bode
from ident.compare import Comparison
from ident.estimate import Estimate
from ident.polezero import PoleZero, Root
from ident.quality import Quality
from ident.verdict import Verdict, excited_band

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["png", "render_page"]

_TEMPLATE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Identification of {{ source }}</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #111; background:
#fff; } h1 { font-size: 1.5rem; margin-bottom: .2rem } h2 { font-size: 1.15rem; margin-top: 2rem; border-bottom: 1px solid #ccc }
.verdict { border: 2px solid #111; padding: .8rem 1rem; margin: 1rem 0 } .verdict strong { font-size: 1.15rem }
.grade { text-transform: uppercase; letter-spacing: .05em; font-size: .85rem; color: #444 }
img { max-width: 100%; height: auto } table { border-collapse: collapse; margin: .5rem 0; font-size: .95rem }
td, th { padding: .2rem .7rem; border-bottom: 1px solid #ddd; text-align: right } td:first-child, th:first-child { text-align:
left }
.wide { overflow-x: auto } caption { text-align: left; color: #444; font-size: .9rem } code { background: #f3f3f3; padding: 0
.2rem } footer { color: #555; font-size: .85rem; margin-top: 2rem }
</style></head><body>
<h1>Identification of {{ source }}</h1>
<p>{{ structure }}, input {{ input }}, output {{ output }}, {{ samples }} samples of {{ dt }} s.</p>
<div class="verdict"><span class="grade">{{ grade }}</span><br><strong>{{ verdict[0] }}</strong>
{% for sentence in verdict[1:] %}<p>{{ sentence }}</p>{% endfor %}</div>
<h2>Frequency response</h2>
<img alt="Bode plot of the model with its 95 % band, spectral estimate, coherence" src="data:image/png;base64,{{ bode }}">
<p>Where the coherence is near one, the output follows the input linearly; where it falls, noise, a nonlinearity or another input
decides, and no linear model of any order will do there.</p>
{% if extrema %}<table><caption>Peaks and notches</caption>
<tr><th></th><th>frequency [Hz]</th><th>magnitude [dB]</th><th></th></tr>
{% for e in extrema %}<tr><td>{{ e.kind }}</td><td>{{ "%.2f"|format(e.frequency_hz) }}</td>
<td>{{ "%.1f"|format(e.magnitude_db) }}</td><td>{{ "" if band[0] <= e.frequency_hz <= band[1] else "extrapolated" }}</td></tr>
{% endfor %}</table>{% endif %}
<h2>What is left over</h2>
<img alt="Correlation of the residuals with themselves and with the input" src="data:image/png;base64,{{ residuals }}">
<h2>Output, measured and simulated</h2>
<img alt="Measured and simulated output over time" src="data:image/png;base64,{{ comparison }}">
<h2>Poles and zeros</h2>
<img alt="Pole-zero map with 95 % regions" src="data:image/png;base64,{{ polezero }}">
<table><caption>Natural frequency and damping by s = ln(z) / dt, with standard errors</caption>
<tr><th></th><th>z</th><th>frequency [Hz]</th><th>damping ratio</th><th></th></tr>
{% for r in roots %}<tr><td>{{ r.kind }}</td><td>{{ r.z }}</td><td>{{ r.frequency }}</td><td>{{ r.damping }}</td>
<td>{{ r.note }}</td></tr>{% endfor %}</table>
{% if orders %}<h2>Orders</h2>
<img alt="Criteria of every order that was tried" src="data:image/png;base64,{{ orders }}">
{% endif %}<h2>Numbers</h2>
<div class="wide"><table><caption>Coefficients with standard errors, rising powers of q<sup>-1</sup></caption>
{% for row in coefficients %}<tr><td>{{ row.name }}</td>{% for c in row.cells %}<td>{{ c }}</td>{% endfor %}</tr>{% endfor
%}</table></div> <table>{% for name, value in figures %}<tr><td>{{ name }}</td><td>{{ value }}</td></tr>{% endfor %}</table>
<table><caption>Starts of the search</caption><tr><th>route</th><th>loss before</th><th>loss after</th><th>iterations</th></tr>
{% for s in starts %}<tr><td>{{ s.route.replace("_", " ") }}</td><td>{{ "%.6g"|format(s.loss_before) }}</td><td>{{
"%.9g"|format(s.loss_after) }}</td> <td>{{ s.iterations }}</td></tr>{% endfor %}</table>
<p>Preprocessing: {{ preprocessing }}.</p>
<footer>Written by <code>simgap identify</code>. All of it as numbers: <code>identification.json</code>.</footer>
</body></html>
"""


def png(figure: Figure) -> bytes:
    """A figure as PNG bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _with_error(value: float, error: float, form: str) -> str:
    return f"{value:{form}}" + (f" ± {error:.1g}" if np.isfinite(error) and error > 0 else "")


def _root_row(kind: str, r: Root) -> dict[str, str]:
    z = f"{r.z.real:.4f}" if abs(r.z.imag) < 1e-12 else f"{r.z.real:.4f} ± {abs(r.z.imag):.4f}i"
    note = "outside the unit circle" if abs(r.z) > 1.0 else ""
    if note and kind == "zero":
        note = "non-minimum phase"
    return {
        "kind": kind,
        "z": z,
        "frequency": _with_error(r.frequency_hz, r.frequency_std_hz, ".4g"),
        "damping": _with_error(r.damping, r.damping_std, ".4f"),
        "note": note,
    }


def _channel(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def render_page(
    estimate: Estimate,
    verdict: Verdict,
    response: Bode,
    roots: PoleZero,
    figures: Quality,
    comparison: Comparison,
    images: dict[str, bytes],
    preprocessing: str,
) -> str:
    """The page as text; ``images`` holds bode, residuals, comparison, polezero and, if orders were tried, orders as PNG bytes."""
    from jinja2 import Environment, StrictUndefined

    model, data = estimate.model, estimate.data
    std = model.std
    rows = []
    for name in "ABCDF":
        values = getattr(model, name)
        if values.size > 1 or name == "B":
            cells = [
                f"{v:.5g}" + (f" ± {e:.2g}" if np.isfinite(e) and e > 0 else "") for v, e in zip(values, std[name], strict=True)
            ]
            rows.append({"name": f"{name} (from q^-{model.structure.nk})" if name == "B" else name, "cells": cells})
    numbers = [
        ("simulation fit", f"{figures.simulation_percent:.2f} %"),
        ("one-step prediction fit", f"{figures.fit_percent:.2f} %"),
        ("loss (mean of e²)", f"{figures.loss:.6g}"),
        ("noise variance", f"{model.noise_variance:.6g}"),
        ("FPE", f"{figures.fpe:.6g}"),
        ("AIC", f"{figures.aic:.6g}"),
        ("BIC", f"{figures.bic:.6g}"),
        ("initial conditions", estimate.initial_condition.value),
        ("search", f"{estimate.status.value}, {estimate.seconds:.2f} s"),
    ]
    if comparison.data is not data:
        numbers.insert(0, (f"simulation fit on {comparison.data.source}", f"{comparison.fit_percent[0]:.2f} %"))
    pairs = [_root_row("pole", r) for r in roots.poles if r.z.imag >= 0] + [
        _root_row("zero", r) for r in roots.zeros if r.z.imag >= 0
    ]
    template = Environment(autoescape=True, undefined=StrictUndefined).from_string(_TEMPLATE)
    return template.render(
        source=data.source,
        structure=str(model.structure),
        input=_channel(data.u_name, data.u_unit),
        output=_channel(data.y_name, data.y_unit),
        samples=len(data),
        dt=f"{data.dt:g}",
        grade=verdict.grade.value,
        verdict=verdict.sentences,
        extrema=response.extrema(),
        band=excited_band(estimate),
        roots=pairs,
        coefficients=rows,
        figures=numbers,
        starts=estimate.starts,
        preprocessing=preprocessing,
        **{"orders": ""} | {name: base64.b64encode(data_).decode() for name, data_ in images.items()},
    )
