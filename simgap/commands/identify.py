"""``simgap identify``: from a recording to a Box-Jenkins model with its uncertainty, figures and a page that judges it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from mjsim.errors import InputError
from simgap.arguments import ModelFile, need_folder, spare_inputs
from simgap.terminal import printable

if TYPE_CHECKING:
    from ident.data import IOData

__all__ = ["command"]

MOST_ORDERS = 20
BODE_POINTS = 1200


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


def _scan(text: str) -> range:
    parts = text.split(":")
    try:
        low, high = (int(p) for p in parts)
    except ValueError:
        low, high = 0, 0
    if not 1 <= low <= high <= MOST_ORDERS:
        raise InputError("--scan", repr(text), f"two whole numbers LOW:HIGH from 1 to {MOST_ORDERS}, such as 2:8")
    return range(low, high + 1)


def _held(data: IOData) -> list[str]:
    """A sentence for each channel that stands still as if samples had been lost."""
    from ident.checks import held_stretch

    out = []
    for x, name in ((data.u, data.u_name), (data.y, data.y_name)):
        if (found := held_stretch(x)) is not None:
            first, count = found
            out.append(
                f"In {data.source} {name} keeps one value for {count} samples from sample {first + 1} on "
                "and repeats no value elsewhere: if samples were lost there, cut the recording."
            )
    return out


@click.command("identify", short_help="Filter, decimate and fit a Box-Jenkins model to a recording.")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--out", "out", type=click.Path(path_type=Path), required=True, help="Folder for the results.")
@click.option("--orders", default="5,5,5,5,1", show_default=True, metavar="NB,NC,ND,NF,NK", help="MATLAB's [nb nc nd nf nk].")
@click.option("--decimate", "factor", type=int, default=10, show_default=True, help="Keep every N-th sample; 1 means all.")
@click.option(
    "--cutoff", default="0.4", show_default=True, metavar="FRACTION|none", help="Cutoff of the low-pass as a fraction of Nyquist."
)
@click.option("--input", "input_column", metavar="COLUMN", help="Input channel (default: the torque).")
@click.option("--output", "output_column", metavar="COLUMN", help="Output channel (default: the velocity, else the angle).")
@click.option(
    "--phase", type=click.Choice(["causal", "zero-phase"]), default="causal", show_default=True, help="Phase of the low-pass."
)
@click.option(
    "--detrend",
    type=click.Choice(["none", "mean", "linear"]),
    default="none",
    show_default=True,
    help="What to subtract from both channels.",
)
@click.option(
    "--validate", type=click.Path(path_type=Path), metavar="RECORDING", help="Simulate this recording too, for validation."
)
@click.option(
    "--scan", metavar="LOW:HIGH", help="Try orders N,N,N,N,NK for each N of the range and use the smallest BIC; draws orders.png."
)
@click.option(
    "--level",
    type=click.Path(path_type=Path),
    metavar="RECORDING",
    help="The same excitation at another amplitude, to test whether the response is linear.",
)
@click.option("--model", type=ModelFile(), metavar="MODEL", help="Model (file or shipped name) whose TOML names the columns.")
@click.option(
    "--clipping",
    type=click.Choice(["refuse", "accept"]),
    default="refuse",
    show_default=True,
    help="What to do with saturated channels (samples that stay at the limit of the range).",
)
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
    scan: str | None,
    level: Path | None,
    model: Path | None,
    clipping: str,
    as_json: bool,
) -> None:
    """Fit a Box-Jenkins model to RECORDING and judge its quality.

    Decimates both channels with an anti-alias filter, applies the same low-pass of order 8 to both, and fits
    y = B/F u + C/D e. Writes identification.json, bode.png, residuals.png and identification.html, all or none.

    Example: simgap identify log.csv --out identified/
    """
    wanted, edge = _orders(orders), _cutoff(cutoff)
    grid = _scan(scan) if scan else None
    from ident.bode import bode, default_frequencies
    from ident.checks import check_clipping, check_moving, check_recording
    from ident.compare import compare
    from ident.data import Detrend, IOData
    from ident.estimate import bj
    from ident.filter import Decimation, LowPass, Phase, shared_filter
    from ident.nonlinearity import amplitude_test
    from ident.options import Options
    from ident.order import select_order
    from ident.page import png, render_page
    from ident.plot import plot_bode, plot_comparison, plot_orders, plot_pole_zero, plot_residuals
    from ident.polezero import pole_zero
    from ident.quality import quality
    from ident.residuals import residual_tests
    from ident.serial import to_dict, write_set
    from ident.spectral import spectral
    from ident.structure import Structure
    from ident.verdict import Grade, alternative, excited_band, judge
    from mjsim.recording import load

    decimation = Decimation(factor)
    low = None if edge is None else LowPass(8, edge, Phase(phase))
    structure = Structure.bj(*wanted)
    accept = clipping == "accept"
    options = Options(accept_clipping=accept)
    need_folder(out)
    names = ("identification.json", "identification.html", "bode.png", "residuals.png", "orders.png")
    spare_inputs([out / name for name in names], [recording, validate, level, model])
    if model is not None and not (model.is_file() or model.with_suffix(".toml").is_file()):
        raise InputError(model, "no such file", "a model, or the .toml beside it", "check the path")

    def read(path: Path) -> IOData:
        raw = IOData.from_recording(load(path, model=model), input_column, output_column)
        raw = replace(raw, u_name=printable(raw.u_name), y_name=printable(raw.y_name), source=printable(raw.source))
        if raw.u_name == raw.y_name:
            raise InputError(raw.source, f"input and output are both {raw.u_name}", "two channels", "name another --output")
        check_moving(raw)
        if not accept:
            check_clipping(raw)
        return raw

    def prepared(raw: IOData) -> IOData:
        return shared_filter(raw.detrended(Detrend(detrend)), decimation, low, filtered=low is not None)

    raw = read(recording)
    check_recording(raw, structure, decimation.factor, clipping=not accept)
    data = prepared(raw)
    held_out = prepared(read(validate)) if validate else None
    other = prepared(read(level)) if level else None
    selection = None
    if grid is not None:
        selection = select_order(data, [Structure.bj(n, n, n, n, wanted[4]) for n in grid], options, held_out)
        estimate = selection.best.estimate
    else:
        estimate = bj(data, wanted, options)
    tests, figures = residual_tests(estimate), quality(estimate)
    verdict = judge(estimate, tests, figures)
    sentences = [*verdict.sentences, *_held(raw)]
    if verdict.grade not in (Grade.GOOD, Grade.NO_EFFECT) and (hint := alternative(estimate, figures)):
        sentences.append(hint)
    nonlinear = None
    if other is not None:
        quiet, loud = sorted((data, other), key=lambda d: float(d.u.std()))
        nonlinear = amplitude_test(quiet, loud)
        sentences.append(f"Against {other.source}: {nonlinear.sentence}")
    verdict = replace(verdict, sentences=tuple(sentences))
    band = excited_band(estimate)
    response = bode(estimate.model, default_frequencies(data.dt, BODE_POINTS, band[0]))
    roots = pole_zero(estimate.model)
    name = str(estimate.model.structure)
    comparison = compare(held_out or data, {name: estimate.model})
    steps = [f"decimated by {factor} (Chebyshev I, order 8, 0.05 dB, zero phase)" if factor > 1 else "not decimated"]
    steps.append(
        f"low-pass Butterworth order 8 at {edge:g} of Nyquist ({edge * data.nyquist_hz:.4g} Hz), {phase}"
        if edge
        else "no low-pass"
    )
    steps.append(f"detrend: {detrend}")
    unit = f"{data.y_unit}/{data.u_unit}" if data.u_unit and data.y_unit else ""
    check = spectral(data) if len(data) >= 64 else None
    images = {
        "bode": png(plot_bode({name: response}, check, band, unit)),
        "residuals": png(plot_residuals(tests)),
        "comparison": png(plot_comparison(comparison)),
        "polezero": png(plot_pole_zero(roots)),
    }
    if selection is not None:
        images["orders"] = png(plot_orders(selection))
    values = to_dict(estimate, tests, response) | {
        "verdict": {"grade": verdict.grade.name.lower(), "sentences": list(verdict.sentences)}
    }
    values["preprocessing"] = steps
    if held_out is not None:
        values["validation"] = {"source": held_out.source, "simulation_fit_percent": comparison.fit_percent[0]}
    if nonlinear is not None and other is not None:
        values["amplitude_test"] = {
            "source": other.source,
            "nonlinear": nonlinear.nonlinear,
            "p_value": nonlinear.p_value,
            "false_alarm_rate": nonlinear.false_alarm_rate,
            "frequency_hz": nonlinear.frequency_hz.tolist(),
            "change_db": nonlinear.change_db.tolist(),
        }
    if selection is not None:
        values["orders_tried"] = [
            {
                "orders": list(c.structure.listed),
                "loss": c.loss,
                "aic": c.aic,
                "bic": c.bic,
                "held_out_percent": c.validation_percent,
            }
            for c in selection.choices
        ]
    text = json.dumps(values, indent=1) + "\n"
    page = render_page(estimate, verdict, response, roots, figures, comparison, images, "; ".join(steps))
    files: dict[Path, str | bytes] = {out / f"{n}.png": images[n] for n in ("bode", "residuals", "orders") if n in images}
    files |= {out / "identification.html": page, out / "identification.json": text}
    try:
        write_set(files)
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})", "a writable folder") from None
    if as_json:
        click.echo(text, nl=False)
        return
    for sentence in verdict.sentences:
        click.echo(printable(sentence))
    if held_out is not None:
        click.echo(f"On {printable(held_out.source)} its simulation fits {comparison.fit_percent[0]:.1f} %.")
    for e in response.extrema():
        note = "" if band[0] <= e.frequency_hz <= band[1] else "  (extrapolated)"
        click.echo(f"  {e.kind:5s} {e.frequency_hz:8.2f} Hz  {e.magnitude_db:7.1f} dB{note}")
    click.echo(f"Written: {out / 'identification.html'}")
