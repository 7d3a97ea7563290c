"""`identify`: a Box-Jenkins model of a recording with its uncertainty, and how good it is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from ident.bode import Bode, bode, default_frequencies
from ident.checks import check_clipping, check_moving, check_recording, held_stretch
from ident.compare import Comparison, compare
from ident.data import Detrend, IOData
from ident.estimate import Estimate, bj
from ident.filter import Decimation, LowPass, Phase, shared_filter
from ident.model import PolyModel
from ident.nonlinearity import AmplitudeTest, amplitude_test
from ident.options import Options
from ident.order import OrderSelection, select_order
from ident.quality import Quality, quality
from ident.residuals import ResidualTests, residual_tests
from ident.serial import to_dict, write_set
from ident.structure import Structure
from ident.verdict import Grade, Verdict, alternative, excited_band, judge
from mjsim.errors import InputError
from mjsim.recording import Recording
from mjsim.recording import load as load_file
from simgap.api.recording import load
from simgap.terminal import printable

if TYPE_CHECKING:
    import pandas
    from control import TransferFunction
    from matplotlib.figure import Figure

__all__ = ["Identification", "identify"]

BODE_POINTS = 1200
LEAST_SPECTRUM = 64  # samples of which a spectrum is estimated
LONGEST = 60_000  # samples that are fitted: standard errors fall by 1/sqrt(N), and the time of a fit grows with N


@final
@dataclass(frozen=True, eq=False)
class Identification:
    """A model y = B/F u + C/D e that `identify` fitted, and what tells how good it is.

    estimate: model and its fit; tests: of the residuals; quality: figures of merit; verdict: grade and sentences; response: Bode
    data with 95 % bands; band [Hz]: where the input excites; comparison: simulated output on the recording, or on the one for
    validation; preprocessing: what was done to the channels; selection, nonlinear: where they were asked for.

    >>> import numpy as np
    >>> import simgap
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(800)
    >>> run = simgap.simulate("pendulum", u, dt=0.02)
    >>> log = {"time_s": run.time, "torque_Nm": u, "velocity_rad_s": run.velocity + 0.001 * rng.standard_normal(800)}
    >>> fitted = simgap.identify(log, orders=(2, 1, 1, 2, 1), decimate=1, cutoff=None)
    >>> system = fitted.transfer_function()  # a control.TransferFunction
    >>> system.dt, len(system.poles())
    (0.02, 2)
    >>> bool(fitted.quality.simulation_percent > 95)
    True
    """

    estimate: Estimate
    tests: ResidualTests
    quality: Quality
    verdict: Verdict
    response: Bode
    band: tuple[float, float]
    comparison: Comparison
    preprocessing: tuple[str, ...]
    held_out: IOData | None = None
    selection: OrderSelection | None = None
    nonlinear: AmplitudeTest | None = None
    level: str = ""

    @property
    def model(self) -> PolyModel:
        """The polynomials B, C, D, F with their covariance."""
        return self.estimate.model

    @property
    def sentences(self) -> tuple[str, ...]:
        """How good the model is, in words."""
        return tuple(self.verdict.sentences)

    def transfer_function(self) -> TransferFunction:
        """B/F, from input to output, as a discrete `control.TransferFunction`."""
        return self.model.to_control()

    def noise_transfer_function(self) -> TransferFunction:
        """C/D, from white noise to output, as a discrete `control.TransferFunction`."""
        return self.model.noise_to_control()

    def as_dict(self) -> dict[str, Any]:
        """The content of ``identification.json``."""
        values = to_dict(self.estimate, self.tests, self.response) | {
            "verdict": {"grade": self.verdict.grade.name.lower(), "sentences": list(self.verdict.sentences)}
        }
        values["preprocessing"] = list(self.preprocessing)
        if self.held_out is not None:
            values["validation"] = {"source": self.held_out.source, "simulation_fit_percent": self.comparison.fit_percent[0]}
        if self.nonlinear is not None:
            values["amplitude_test"] = {
                "source": self.level,
                "nonlinear": self.nonlinear.nonlinear,
                "p_value": self.nonlinear.p_value,
                "false_alarm_rate": self.nonlinear.false_alarm_rate,
                "frequency_hz": self.nonlinear.frequency_hz.tolist(),
                "change_db": self.nonlinear.change_db.tolist(),
            }
        if self.selection is not None:
            values["orders_tried"] = [
                {
                    "orders": list(c.structure.listed),
                    "loss": c.loss,
                    "aic": c.aic,
                    "bic": c.bic,
                    "held_out_percent": c.validation_percent,
                }
                for c in self.selection.choices
            ]
        return values

    def to_frame(self) -> pandas.DataFrame:
        """A row for each coefficient: polynomial, power of q^-1, value, standard error. Needs pandas."""
        from simgap.api.frames import frame

        std = self.model.std
        first = {"B": self.model.structure.nk}
        rows = [
            {"polynomial": name, "power": first.get(name, 0) + k, "value": float(value), "std": float(std[name][k])}
            for name in "BCDF" for k, value in enumerate(getattr(self.model, name))
        ]  # fmt: skip
        return frame(("polynomial", "power", "value", "std"), rows)

    def plot(self) -> Figure:
        """Bode plot with its 95 % band, beside the spectral estimate, as a matplotlib figure."""
        from ident.plot import plot_bode
        from ident.spectral import spectral

        data = self.estimate.data
        unit = f"{data.y_unit}/{data.u_unit}" if data.u_unit and data.y_unit else ""
        check = spectral(data) if len(data) >= LEAST_SPECTRUM else None
        return plot_bode({str(self.model.structure): self.response}, check, self.band, unit)

    def report(self, path: str | Path) -> Path:
        """Write the page that judges the model, one HTML file; returns its path."""
        path = Path(path)
        write_set({path: self._page(self._images())})
        return path

    def save(self, folder: str | Path) -> Path:
        """Write identification.json, identification.html and the pictures into a folder, all or none; returns it."""
        out, images = Path(folder), self._images()
        files: dict[Path, str | bytes] = {out / f"{n}.png": images[n] for n in ("bode", "residuals", "orders") if n in images}
        files |= {out / "identification.html": self._page(images), out / "identification.json": self.text()}
        write_set(files)
        return out

    def text(self) -> str:
        """``identification.json`` as text."""
        return json.dumps(self.as_dict(), indent=1) + "\n"

    def _images(self) -> dict[str, bytes]:
        from ident.page import png
        from ident.plot import plot_comparison, plot_orders, plot_pole_zero, plot_residuals
        from ident.polezero import pole_zero

        images = {
            "bode": png(self.plot()),
            "residuals": png(plot_residuals(self.tests)),
            "comparison": png(plot_comparison(self.comparison)),
            "polezero": png(plot_pole_zero(pole_zero(self.model))),
        }
        if self.selection is not None:
            images["orders"] = png(plot_orders(self.selection))
        return images

    def _page(self, images: dict[str, bytes]) -> str:
        from diagnose.report.components import data_table, theme_button
        from diagnose.report.document import document
        from ident.page import render_page
        from ident.polezero import pole_zero

        body = render_page(
            self.estimate, self.verdict, self.response, pole_zero(self.model), self.quality, self.comparison, images,
            "; ".join(self.preprocessing), data_table, theme_button(),
        )  # fmt: skip
        return document(f"Identification of {self.estimate.data.source}", body)


def identify(
    recording: Any,
    *,
    orders: tuple[int, int, int, int, int] = (5, 5, 5, 5, 1),
    decimate: int = 10,
    cutoff: float | None = 0.4,
    input: str | None = None,
    output: str | None = None,
    phase: str = "causal",
    detrend: str = "none",
    validate: Any = None,
    level: Any = None,
    scan: Sequence[int] = (),
    model: str | Path | None = None,
    accept_clipping: bool = False,
) -> Identification:
    """Fit a Box-Jenkins model y = B/F u + C/D e to a recording and judge it.

    ``recording``: a file, columns by name, a DataFrame or a `Recording`. ``orders``: nb, nc, nd, nf, nk as MATLAB's ``bj`` has
    them. ``decimate``: keep every N-th sample behind an anti-alias filter; ``cutoff``: of the low-pass on both channels, as a
    fraction of Nyquist, None for none; ``phase``: ``"causal"`` or ``"zero-phase"``; ``detrend``: ``"none"``, ``"mean"`` or
    ``"linear"``. ``input``, ``output``: channels, by default torque, and velocity or else angle. ``validate``: a recording that
    the model is simulated on as well; ``level``: the same excitation at another amplitude, which tells whether the response is
    linear; ``scan``: orders N,N,N,N,nk to choose from by BIC. ``model``: whose TOML file names the columns. Of more than
    60,000 decimated samples the contiguous stretch of that length in which the output varies most is fitted, and the model is
    simulated on all of them. Raises `InputError`.

    >>> import numpy as np
    >>> import simgap
    >>> u = np.random.default_rng(0).standard_normal(400)
    >>> y = np.zeros(400)
    >>> for k in range(1, 400):
    ...     y[k] = 0.9 * y[k - 1] + 0.5 * u[k - 1]
    >>> y += 0.01 * np.random.default_rng(1).standard_normal(400)
    >>> log = {"time_s": 0.01 * np.arange(400), "torque_Nm": u, "velocity_rad_s": y}
    >>> fitted = simgap.identify(log, orders=(1, 0, 0, 1, 1), decimate=1, cutoff=None)
    >>> round(float(fitted.model.F[1]), 2), round(float(fitted.model.B[0]), 2)
    (-0.9, 0.5)
    """
    decimation, structure = Decimation(decimate), Structure.bj(*orders)
    low = None if cutoff is None else LowPass(8, cutoff, Phase(phase))
    options = Options(accept_clipping=accept_clipping)

    def read(source: Any) -> IOData:
        raw = IOData.from_recording(_recording(source, model), input, output)
        raw = replace(raw, u_name=printable(raw.u_name), y_name=printable(raw.y_name), source=printable(raw.source))
        if raw.u_name == raw.y_name:
            raise InputError(raw.source, f"input and output are both {raw.u_name}", "two channels", "name another --output")
        check_moving(raw)
        if not accept_clipping:
            check_clipping(raw)
        return raw

    def prepared(raw: IOData) -> IOData:
        return shared_filter(raw.detrended(Detrend(detrend)), decimation, low, filtered=low is not None)

    raw = read(recording)
    check_recording(raw, structure, decimation.factor, clipping=not accept_clipping)
    whole = prepared(raw)
    data, first = _stretch(whole)
    held_out = None if validate is None else prepared(read(validate))
    other = None if level is None else prepared(read(level))
    selection = None
    if scan:
        selection = select_order(data, [Structure.bj(n, n, n, n, orders[4]) for n in scan], options, held_out)
        estimate = selection.best.estimate
    else:
        estimate = bj(data, orders, options)
    tests, figures = residual_tests(estimate), quality(estimate)
    nonlinear = None
    if other is not None:
        quiet, loud = sorted((data, other), key=lambda d: float(d.u.std()))
        nonlinear = amplitude_test(quiet, loud)
    band = excited_band(estimate)
    steps = (*_steps(data, decimate, cutoff, phase, detrend), *_chosen(whole, data, first))
    return Identification(
        estimate, tests, figures, _judged(estimate, tests, figures, raw, nonlinear, other),
        bode(estimate.model, default_frequencies(data.dt, BODE_POINTS, band[0])), band,
        compare(held_out or whole, {str(estimate.model.structure): estimate.model}),
        steps, held_out, selection, nonlinear, "" if other is None else other.source,
    )  # fmt: skip


def _stretch(data: IOData) -> tuple[IOData, int]:
    """The stretch that is fitted and its first sample: that of the largest output variance."""
    if len(data) <= LONGEST:
        return data, 0
    starts = range(0, len(data) - LONGEST + 1, LONGEST // 2)
    first = max(starts, key=lambda k: float(np.var(data.y[k : k + LONGEST])))
    return data.part(first, first + LONGEST), first


def _chosen(whole: IOData, data: IOData, first: int) -> tuple[str, ...]:
    """Which samples are fitted, in words; nothing where all are."""
    if len(data) == len(whole):
        return ()
    begin, end = float(whole.time[first]), float(whole.time[first + len(data) - 1])
    return (f"fitted to {begin:.6g} to {end:.6g} s, {len(data)} of {len(whole)} samples: there the output varies most",)


def _recording(source: Any, model: str | Path | None) -> Recording:
    if isinstance(source, Recording):
        return source
    found = load_file(Path(source), model=model) if isinstance(source, str | Path) else load(source)
    assert isinstance(found, Recording)
    return found


def _judged(
    estimate: Estimate, tests: ResidualTests, figures: Quality, raw: IOData, nonlinear: AmplitudeTest | None, other: IOData | None
) -> Verdict:
    """The verdict, with sentences on channels that stand still and on a recording at another amplitude."""
    verdict = judge(estimate, tests, figures)
    sentences = [*verdict.sentences, *_held(raw)]
    if verdict.grade not in (Grade.GOOD, Grade.NO_EFFECT) and (hint := alternative(estimate, figures)):
        sentences.append(hint)
    if nonlinear is not None and other is not None:
        sentences.append(f"Against {other.source}: {nonlinear.sentence}")
    return replace(verdict, sentences=tuple(sentences))


def _held(data: IOData) -> list[str]:
    """A sentence for each channel that stands still as if samples had been lost."""
    out = []
    for x, name in ((data.u, data.u_name), (data.y, data.y_name)):
        if (found := held_stretch(x)) is not None:
            first, count = found
            out.append(
                f"In {data.source} {name} keeps one value for {count} samples from sample {first + 1} on "
                "and repeats no value elsewhere: if samples were lost there, cut the recording."
            )
    return out


def _steps(data: IOData, decimate: int, cutoff: float | None, phase: str, detrend: str) -> tuple[str, ...]:
    """What was done to the channels, in words."""
    return (
        f"decimated by {decimate} (Chebyshev I, order 8, 0.05 dB, zero phase)" if decimate > 1 else "not decimated",
        f"low-pass Butterworth order 8 at {cutoff:g} of Nyquist ({cutoff * data.nyquist_hz:.4g} Hz), {phase}"
        if cutoff
        else "no low-pass",
        f"detrend: {detrend}",
    )
