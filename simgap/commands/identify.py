"""``simgap identify``: from a recording to a Box-Jenkins model with its uncertainty, figures and a page that judges it."""

from __future__ import annotations

from pathlib import Path

import click

from mjsim.errors import InputError, nearest_file
from simgap.arguments import Choice, InputFile, ModelFile, OutputFolder, spare_inputs, take_folder
from simgap.terminal import printable

__all__ = ["command"]

MOST_ORDERS = 20


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


@click.command("identify", short_help="Filter, decimate and fit a Box-Jenkins model to a recording.")
@click.argument("recording", type=InputFile())
@click.option("--out", "out", type=OutputFolder(), required=True, help="Folder for the results.")
@click.option("--orders", default="5,5,5,5,1", show_default=True, metavar="NB,NC,ND,NF,NK", help="MATLAB's [nb nc nd nf nk].")
@click.option("--decimate", "factor", type=int, default=10, show_default=True, help="Keep every N-th sample; 1 means all.")
@click.option(
    "--cutoff", default="0.4", show_default=True, metavar="FRACTION|none", help="Cutoff of the low-pass as a fraction of Nyquist."
)
@click.option("--input", "input_column", metavar="COLUMN", help="Input channel (default: the torque).")
@click.option("--output", "output_column", metavar="COLUMN", help="Output channel (default: the velocity, else the angle).")
@click.option(
    "--phase", type=Choice(["causal", "zero-phase"]), default="causal", show_default=True, help="Phase of the low-pass."
)
@click.option(
    "--detrend",
    type=Choice(["none", "mean", "linear"]),
    default="none",
    show_default=True,
    help="What to subtract from both channels.",
)
@click.option("--validate", type=InputFile(), metavar="RECORDING", help="Simulate this recording too, for validation.")
@click.option(
    "--scan", metavar="LOW:HIGH", help="Try orders N,N,N,N,NK for each N of the range and use the smallest BIC; draws orders.png."
)
@click.option(
    "--level",
    type=InputFile(),
    metavar="RECORDING",
    help="The same excitation at another amplitude, to test whether the response is linear.",
)
@click.option("--model", type=ModelFile(), metavar="MODEL", help="Model (file or shipped name) whose TOML names the columns.")
@click.option(
    "--clipping",
    type=Choice(["refuse", "accept"]),
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
    y = B/F u + C/D e. Of more than 60,000 decimated samples the stretch of that length in which the output varies most is
    fitted. Writes identification.json, bode.png, residuals.png and identification.html, all or none.

    Example: simgap identify log.csv --out identified/
    """
    wanted, edge = _orders(orders), _cutoff(cutoff)
    grid = _scan(scan) if scan else range(0)
    from simgap.api.identifying import identify

    take_folder(out)
    names = ("identification.json", "identification.html", "bode.png", "residuals.png", "orders.png")
    spare_inputs([out / name for name in names], [recording, validate, level, model])
    if model is not None and not (model.is_file() or model.with_suffix(".toml").is_file()):
        raise InputError(model, "no such file", "a model, or the .toml beside it", nearest_file(model, ".xml", ".toml"))
    fitted = identify(
        recording, orders=wanted, decimate=factor, cutoff=edge, input=input_column, output=output_column, phase=phase,
        detrend=detrend, validate=validate, level=level, scan=grid, model=model, accept_clipping=clipping == "accept",
    )  # fmt: skip
    try:
        fitted.save(out)
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})", "a writable folder") from None
    if as_json:
        click.echo(fitted.text(), nl=False)
        return
    for sentence in fitted.sentences:
        click.echo(printable(sentence))
    if fitted.held_out is not None:
        click.echo(f"On {printable(fitted.held_out.source)} its simulation fits {fitted.comparison.fit_percent[0]:.1f} %.")
    for e in fitted.response.extrema():
        note = "" if fitted.band[0] <= e.frequency_hz <= fitted.band[1] else "  (extrapolated)"
        click.echo(f"  {e.kind:5s} {e.frequency_hz:8.2f} Hz  {e.magnitude_db:7.1f} dB{note}")
    click.echo(f"Written: {out / 'identification.html'}")
