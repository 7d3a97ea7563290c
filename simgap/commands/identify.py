"""``simgap identify``: from a recording to a Box-Jenkins model with its uncertainty, figures and a page that judges it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mjsim.errors import InputError

if TYPE_CHECKING:
    from ident.data import IOData

__all__ = ["command"]

_UNITS = {"torque": "Nm", "velocity": "rad/s", "angle": "rad"}
_SUFFIXES = (
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_Nm", "Nm"),
    ("_N", "N"),
    ("_rad", "rad"),
    ("_deg", "deg"),
    ("_m", "m"),
    ("_V", "V"),
    ("_A", "A"),
)


def _orders(text: str) -> tuple[int, int, int, int, int]:
    parts = text.replace(" ", "").split(",")
    try:
        values = tuple(int(p) for p in parts)
    except ValueError:
        values = ()
    if len(values) != 5:
        raise InputError("--orders", repr(text), "five whole numbers nb,nc,nd,nf,nk such as 5,5,5,5,1")
    nb, nc, nd, nf, nk = values
    return nb, nc, nd, nf, nk


def _cutoff(text: str) -> float | None:
    if text.strip().lower() == "none":
        return None
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise InputError("--cutoff", repr(text), "a fraction of Nyquist between 0 and 1, or none")
    return value


def _unit(name: str) -> str:
    return _UNITS.get(name) or next((unit for suffix, unit in _SUFFIXES if name.endswith(suffix)), "")


def _read(path: Path, input_column: str | None, output_column: str | None) -> IOData:
    """The two channels of a recording, checked for clipping before any filter hides it."""
    from ident.checks import check_clipping
    from ident.data import IOData
    from mjsim.recording import load

    recording = load(path)
    name_in = input_column or "torque"
    name_out = output_column or ("velocity" if recording.velocity is not None else "angle")
    data = IOData(
        recording.column(name_in),
        recording.column(name_out),
        recording.dt,
        name_in,
        name_out,
        _unit(name_in),
        _unit(name_out),
        recording.source,
    )
    check_clipping(data)
    return data


@click.command("identify", short_help="Filter, decimate and fit a Box-Jenkins model to a recording.")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--out", "out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the results.")
@click.option("--orders", default="5,5,5,5,1", show_default=True, metavar="NB,NC,ND,NF,NK", help="MATLAB's [nb nc nd nf nk].")
@click.option("--decimate", "factor", type=int, default=10, show_default=True, help="Keep every N-th sample; 1 means all.")
@click.option("--cutoff", default="0.4", show_default=True, metavar="FRACTION|none", help="Low-pass edge, fraction of Nyquist.")
@click.option("--input", "input_column", metavar="COLUMN", help="Input channel (default: the torque).")
@click.option("--output", "output_column", metavar="COLUMN", help="Output channel (default: the velocity, else the angle).")
@click.option(
    "--phase", type=click.Choice(["causal", "zero-phase"]), default="causal", show_default=True, help="Of the low-pass."
)
@click.option(
    "--detrend", type=click.Choice(["none", "mean", "linear"]), default="none", show_default=True, help="Taken off both channels."
)
@click.option("--validate", type=click.Path(path_type=Path), metavar="RECORDING", help="Another recording to simulate.")
@click.option("--json", "as_json", is_flag=True, help="Print identification.json on standard output.")
def command(
    recording: Path,
    out: Path,
    orders: str,
    factor: int,
    cutoff: str,
    input_column: str | None,
    output_column: str | None,
    phase: str,
    detrend: str,
    validate: Path | None,
    as_json: bool,
) -> None:
    """Fit a Box-Jenkins model to RECORDING and say whether it is good.

    The recording is decimated (anti-alias filter), both channels are low-passed alike (order 8),
    then y = B/F u + C/D e is fitted.
    Writes identification.json, bode.png, residuals.png and identification.html.

    Example: simgap identify log.csv --out identified/
    """
    wanted, edge = _orders(orders), _cutoff(cutoff)
    from ident.bode import bode
    from ident.data import Detrend
    from ident.estimate import bj
    from ident.filter import Decimation, LowPass, Phase, shared_filter
    from ident.page import png, render_page
    from ident.plot import plot_bode, plot_comparison, plot_pole_zero, plot_residuals
    from ident.polezero import pole_zero
    from ident.predict import compare
    from ident.quality import quality
    from ident.residuals import residual_tests
    from ident.serial import to_dict, write_atomic
    from ident.spectral import spectral
    from ident.verdict import Grade, alternative, excited_band, judge

    decimation = Decimation(factor)
    low = None if edge is None else LowPass(8, edge, Phase(phase))

    def prepared(path: Path) -> IOData:
        raw = _read(path, input_column, output_column).detrended(Detrend(detrend))
        return shared_filter(raw, decimation, low, filtered=low is not None)

    data = prepared(recording)
    held_out = prepared(validate) if validate else None
    if out.exists() and not out.is_dir():
        raise InputError(out, "it is a file", "a folder", "name another --out")
    estimate = bj(data, wanted)
    tests, figures = residual_tests(estimate), quality(estimate)
    verdict = judge(estimate, tests, figures)
    if verdict.grade is not Grade.GOOD and (hint := alternative(estimate, figures)):
        verdict = replace(verdict, sentences=(*verdict.sentences, hint))
    response, roots = bode(estimate.model), pole_zero(estimate.model)
    comparison = compare(held_out or data, {str(estimate.model.structure): estimate.model})
    steps = [f"decimated by {factor} (Chebyshev I, order 8, 0.05 dB, zero phase)" if factor > 1 else "not decimated"]
    steps.append(
        f"low-pass Butterworth order 8 at {edge:g} of Nyquist ({edge * data.nyquist_hz:.4g} Hz), {phase}"
        if edge
        else "no low-pass"
    )
    steps.append(f"detrend: {detrend}")
    unit = f"{data.y_unit}/{data.u_unit}" if data.u_unit and data.y_unit else ""
    band = excited_band(estimate)
    check = spectral(data) if len(data) >= 64 else None
    images = {
        "bode": png(plot_bode({str(estimate.model.structure): response}, check, band, unit)),
        "residuals": png(plot_residuals(tests)),
        "comparison": png(plot_comparison(comparison)),
        "polezero": png(plot_pole_zero(roots)),
    }
    values = to_dict(estimate, tests) | {"verdict": {"grade": verdict.grade.name.lower(), "sentences": list(verdict.sentences)}}
    values["preprocessing"] = steps
    if held_out is not None:
        values["validation"] = {"source": held_out.source, "simulation_fit_percent": comparison.fit_percent[0]}
    text = json.dumps(values, indent=1) + "\n"
    page = render_page(estimate, verdict, response, roots, figures, comparison, images, "; ".join(steps))
    try:
        write_atomic(out / "bode.png", images["bode"])
        write_atomic(out / "residuals.png", images["residuals"])
        write_atomic(out / "identification.html", page)
        write_atomic(out / "identification.json", text)
    except OSError as error:
        raise InputError(out, f"cannot write there ({error.strerror})", "a folder that can be written") from None
    if as_json:
        click.echo(text, nl=False)
        return
    for sentence in verdict.sentences:
        click.echo(sentence)
    if held_out is not None:
        click.echo(f"On {held_out.source} its simulation fits {comparison.fit_percent[0]:.1f} %.")
    for e in response.extrema():
        note = "" if band[0] <= e.frequency_hz <= band[1] else "  (extrapolated)"
        click.echo(f"  {e.kind:5s} {e.frequency_hz:8.2f} Hz  {e.magnitude_db:7.1f} dB{note}")
    click.echo(f"Written: {out / 'identification.html'}")
