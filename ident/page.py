"""The body of ``identification.html``: the verdict in words, the figures, the numbers."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ident.bode import Bode
from ident.compare import Comparison
from ident.estimate import Estimate
from ident.polezero import PoleZero, Root
from ident.quality import Quality
from ident.verdict import Grade, Verdict, excited_band

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["png", "render_page"]

# classes of the pages' style sheet
_COLOURS = {Grade.GOOD: "good", Grade.PLANT_GOOD: "info", Grade.POOR: "alarm", Grade.NO_EFFECT: "alarm"}

_TEMPLATE = """<header>
<p class="kicker">Identification of {{ source }}: {{ structure }}, input {{ input }}, output {{ output }}, {{ samples }} samples
of {{ dt }} s</p>
{{ switch }}
<p class="verdict"><span class="badge {{ colour }}">{{ grade }}</span></p>
<h1>{{ verdict[0] }}</h1>
{% for sentence in verdict[1:] %}<p>{{ sentence }}</p>
{% endfor %}<nav aria-label="Contents"><a href="#response">Frequency response</a><a href="#residuals">Residuals</a>
<a href="#output">Output</a><a href="#roots">Poles and zeros</a>{% if orders %}<a href="#orders">Orders</a>{% endif %}
<a href="#numbers">Numbers</a></nav>
</header>
<main id="content">
<section id="response"><h2>Frequency response</h2>
<figure class="photo"><img alt="Bode plot of the model with its 95 % band, spectral estimate, coherence"
src="data:image/png;base64,{{ bode }}">
<figcaption>Where the coherence is near one, the output follows the input linearly; where it falls, noise, a nonlinearity or
another input decides, and no linear model of any order describes it.</figcaption></figure>
{{ extrema }}</section>
<section id="residuals"><h2>Residuals</h2>
<figure class="photo"><img alt="Correlation of the residuals with themselves and with the input"
src="data:image/png;base64,{{ residuals }}"></figure></section>
<section id="output"><h2>Output, measured and simulated</h2>
<figure class="photo"><img alt="Measured and simulated output over time" src="data:image/png;base64,{{ comparison }}"></figure>
</section>
<section id="roots"><h2>Poles and zeros</h2>
<figure class="photo"><img alt="Pole-zero map with 95 % regions" src="data:image/png;base64,{{ polezero }}"></figure>
{{ roots }}</section>
{% if orders %}<section id="orders"><h2>Orders</h2>
<figure class="photo"><img alt="Criteria of every order that was tried"
src="data:image/png;base64,{{ orders }}"></figure></section>
{% endif %}<section id="numbers"><h2>Numbers</h2>
{{ coefficients }}
{{ figures }}
{{ starts }}
<p>Preprocessing: {{ preprocessing }}.</p></section>
</main>
<footer><p>Written by <code>simgap identify</code>. All numbers: <code>identification.json</code>.</p></footer>
"""


def png(figure: Figure) -> bytes:
    """A figure as PNG bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _with_error(value: float, error: float, form: str) -> str:
    return f"{value:{form}}" + (f" ± {error:.1g}" if np.isfinite(error) and error > 0 else "")


def _root_row(kind: str, r: Root) -> tuple[str, ...]:
    z = f"{r.z.real:.4f}" if abs(r.z.imag) < 1e-12 else f"{r.z.real:.4f} ± {abs(r.z.imag):.4f}i"
    note = "outside the unit circle" if abs(r.z) > 1.0 else ""
    if note and kind == "zero":
        note = "non-minimum phase"
    frequency, damping = _with_error(r.frequency_hz, r.frequency_std_hz, ".4g"), _with_error(r.damping, r.damping_std, ".4f")
    return kind, z, frequency, damping, note


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
    table: Callable[..., str],
    switch: str = "",
) -> str:
    """What stands in the body of the page.

    ``images`` holds bode, residuals, comparison, polezero and, if orders were tried, orders as PNG bytes. ``table``: HTML of
    a table by heads, rows, indices of numeric columns and a caption; ``switch``: markup of the control that switches the colours.
    """
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    model, data = estimate.model, estimate.data
    std = model.std
    rows = []
    for name in "ABCDF":
        values = getattr(model, name)
        if values.size > 1 or name == "B":
            cells = [
                f"{v:.5g}" + (f" ± {e:.2g}" if np.isfinite(e) and e > 0 else "") for v, e in zip(values, std[name], strict=True)
            ]
            rows.append([f"{name} (from q^-{model.structure.nk})" if name == "B" else name, *cells])
    longest = max(map(len, rows))
    powers = [f"term {i}" for i in range(1, longest)]
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
    pairs = [_root_row("pole", r) for r in roots.poles if r.z.imag >= 0]
    pairs += [_root_row("zero", r) for r in roots.zeros if r.z.imag >= 0]
    band = excited_band(estimate)
    extrema = [
        (e.kind, f"{e.frequency_hz:.2f}", f"{e.magnitude_db:.1f}", "" if band[0] <= e.frequency_hz <= band[1] else "extrapolated")
        for e in response.extrema()
    ]
    starts = [
        (s.route.replace("_", " "), f"{s.loss_before:.6g}", f"{s.loss_after:.9g}", str(s.iterations)) for s in estimate.starts
    ]
    told = "Natural frequency and damping by s = ln(z) / dt, with standard errors"
    heads = ("Kind", "z", "Frequency [Hz]", "Damping ratio", "Note")
    template = Environment(autoescape=True, undefined=StrictUndefined).from_string(_TEMPLATE)
    return template.render(
        source=data.source,
        structure=str(model.structure),
        input=_channel(data.u_name, data.u_unit),
        output=_channel(data.y_name, data.y_unit),
        samples=len(data),
        dt=f"{data.dt:g}",
        grade=verdict.grade.value,
        colour=_COLOURS.get(verdict.grade, "warn"),
        switch=Markup(switch),
        verdict=verdict.sentences,
        extrema=table(("Kind", "Frequency [Hz]", "Magnitude [dB]", "Note"), extrema, numeric=(1, 2), caption="Peaks and notches")
        if extrema
        else "",
        roots=table(heads, pairs, numeric=(1, 2, 3), caption=told),
        coefficients=table(
            ("Polynomial", *powers),
            [[*r, *[""] * (longest - len(r))] for r in rows],
            numeric=range(1, longest),
            caption="Coefficients with standard errors, rising powers of 1/q",
        ),
        figures=table(("Figure", "Value"), numbers, numeric=(1,)),
        starts=table(
            ("Route", "Loss before", "Loss after", "Iterations"), starts, numeric=(1, 2, 3), caption="Starts of the search"
        ),
        preprocessing=preprocessing,
        **{"orders": ""} | {name: base64.b64encode(data_).decode() for name, data_ in images.items()},
    )
