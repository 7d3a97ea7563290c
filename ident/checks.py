"""What data must have before a model is fitted to them; each lack is one clear line."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ident.data import IOData
from ident.structure import Structure
from mjsim.errors import InputError
from mjsim.signals import limits

__all__ = [
    "check_clipping",
    "check_diverging",
    "check_estimation_data",
    "check_moving",
    "check_recording",
    "excited_bins",
    "excited_directions",
    "held_stretch",
    "missing_bands",
]

CONSTANT = 1e-14
"""Range relative to its size below which a channel is constant."""
WELL_CONDITIONED = 1e-5
"""Relative size above which a direction of the input's lags counts, whatever its spectrum."""
LINE_FLOOR = 1e-7
"""Power relative to the largest line's above which a bin counts as excited; the window's sidelobes lie below 1e-9."""
BINS_PER_LINE = 7
"""Bins above the floor under one sine."""
HELD_SAMPLES = 10
"""Equal samples in a row from which on a channel that never repeats is said to be held."""


def excited_bins(u: np.ndarray, floor: float = 1e-10) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [cycles per sample] and whether the input's power there exceeds ``floor`` of its largest line."""
    n = u.size
    window = np.hanning(n) if n > 2 else np.ones(n)
    power = np.abs(np.fft.rfft(u * window)) ** 2
    return np.arange(power.size) / n, power > floor * max(float(power.max()), 1e-300)


def missing_bands(u: np.ndarray, dt: float, floor: float = 1e-6) -> list[tuple[float, float]]:
    """Bands [Hz] wider than 2 % of Nyquist in which the input has no power (relative ``floor``)."""
    frequency, excited = excited_bins(u, floor)
    f = frequency / dt
    reach = max(1, round(0.005 * f.size))
    smooth = np.convolve(excited.astype(float), np.ones(2 * reach + 1), "same") > 0
    bands: list[tuple[float, float]] = []
    start = None
    for i, on in enumerate(np.r_[smooth, True]):
        if not on and start is None:
            start = i
        if on and start is not None:
            low, high = f[start], f[min(i, f.size - 1)]
            if high - low > 0.01 / dt:
                bands.append((float(low), float(high)))
            start = None
    return bands


def excited_directions(u: np.ndarray, order: int) -> int:
    """How many coefficients of a model the input can tell apart, at most ``order``: its order of persistent excitation.

    The larger of two counts. The rank of the covariance of ``order`` lags of u, down to ``WELL_CONDITIONED``: enough for any
    broadband input. And two for every spectral line, a line being as wide as a sine's under a Blackman-Harris window: a chirp
    sampled fast has lags that are nearly alike, but power at hundreds of lines; three sines have six directions, however finely
    they are printed.
    """
    from scipy.signal.windows import blackmanharris

    n = u.size
    columns = np.stack([u[order - i : n - i] for i in range(order)])
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(columns @ columns.T), 0.0))
    rank = int(np.sum(values > WELL_CONDITIONED * max(float(values[-1]), 1e-300)))
    power = np.abs(np.fft.rfft(u * blackmanharris(n))) ** 2
    excited = power > LINE_FLOOR * max(float(power.max()), 1e-300)
    lines = int(np.sum(excited) / BINS_PER_LINE + 0.5)
    return min(order, max(rank, 2 * lines - int(excited[0])))  # a constant is one direction, a sine two


def check_moving(data: IOData) -> None:
    """Raise InputError when a channel never moves."""
    for x, what in _channels(data):
        if float(np.ptp(x)) <= CONSTANT * max(float(np.max(np.abs(x))), 1e-300):
            raise InputError(data.source, f"{what} is constant ({x[0]:.6g})", "a signal that moves", "excite the system")


def _channels(data: IOData) -> tuple[tuple[np.ndarray, str], ...]:
    return (data.u, f"input {data.u_name}"), (data.y, f"output {data.y_name}")


def check_clipping(data: IOData, *, channels: str = "uy") -> None:
    """Raise InputError when a channel sits at its own largest or smallest value for runs of samples, as a clipped one does.

    What `mjsim.signals.limits` tells, but for an input that dwells on other levels as long.
    ``channels``: which of u and y to look at.
    """
    for (x, what), name in zip(_channels(data), "uy", strict=True):
        if name not in channels:
            continue
        span = float(np.ptp(x))
        inside = (x < x.max() - 1e-12 * span) & (x > x.min() + 1e-12 * span)
        for limit in limits(x):
            if name == "u" and _longest_run(x, inside) >= limit.share * x.size / (limit.visits + 1):
                continue  # it dwells on other levels as long: a staircase
            raise InputError(
                data.source,
                f"{what} sits at its limit {limit.value:.6g} in {100 * limit.share:.1f} % of the samples, "
                f"first at sample {limit.first + 1} (clipped)",
                "a signal within its range",
                "record with less amplitude or a wider range"
                if name == "y"
                else "log what was applied after the limit; if this is it, say so (--clipping accept)",
            )


def _longest_run(x: np.ndarray, where: np.ndarray) -> int:
    """Most samples in a row that are equal and lie in ``where``."""
    same = (np.diff(x) == 0.0) & where[1:] & where[:-1]
    edges = np.flatnonzero(np.diff(np.r_[0, same.astype(int), 0]))
    return int(np.max(edges[1::2] - edges[::2], initial=-1)) + 1


def held_stretch(x: np.ndarray) -> tuple[int, int] | None:
    """(first sample, count) of the longest stretch over which a channel that else never repeats holds one value, or None.

    That is what dropped samples look like after a logger filled them in. Rest at zero does not count, nor does a channel that
    often repeats its value (a quantised one).
    """
    same = np.diff(x) == 0.0
    edges = np.flatnonzero(np.diff(np.r_[0, same.astype(int), 0]))
    if edges.size == 0:
        return None
    first, length = edges[::2], edges[1::2] - edges[::2]
    longest = int(np.argmax(length))
    elsewhere = int(same.sum()) - int(length[longest])
    if length[longest] + 1 < HELD_SAMPLES or elsewhere > 0.01 * x.size or x[first[longest]] == 0.0:
        return None
    return int(first[longest]), int(length[longest]) + 1


def check_recording(data: IOData, s: Structure, factor: int = 1, *, clipping: bool = True) -> None:
    """What a recording must have before a filter hides it: channels that move, are not clipped, and an input rich enough.

    The excitation is judged on every ``factor``-th sample as recorded, for the transient of a filter would pass for excitation.
    ``clipping=False`` accepts channels that sit at their limits. Raises InputError with the sample, the limit or the missing
    frequencies.
    """
    _check_length(data, len(data) // factor, s)
    check_moving(data)
    if clipping:
        check_clipping(data)
    check_diverging(data)
    _check_excitation(data, np.asarray(data.u)[::factor], s)


def check_diverging(data: IOData) -> None:
    """Raise InputError when the output runs away by itself.

    Two signs together: the standard deviation over sixteenths of the record keeps growing to the end, far beyond its usual size
    and without the input growing; and a least-squares ARX model of order four has a pole outside the unit circle that alone
    accounts for that growth. A resonance that a chirp reaches at last shows the first only.
    """
    n = len(data)
    if n < 16 * 8:
        return
    edges = np.linspace(0, n, 17).astype(int)
    out, into = (np.array([np.std(x[a:b]) for a, b in pairwise(edges)]) for x in (data.y, data.u))
    usual = float(np.median(out[:12]))
    if not (np.all(out[13:] > 1.3 * out[12:-1]) and out[-1] > 30 * usual and into[-1] < 10 * float(np.median(into)) + 1e-300):
        return
    stride = max(1, n // 4000)  # decimated by taking every so many samples: a growing mode stays one
    y, u = (np.asarray(x)[::stride] / (float(np.max(np.abs(x))) or 1.0) for x in (data.y, data.u))
    order = 4
    rows = np.column_stack(
        [y[order - i : y.size - i] for i in range(1, order + 1)] + [u[order - i : u.size - i] for i in range(5)]
    )
    poly = np.r_[1.0, -np.linalg.lstsq(rows, y[order:], rcond=None)[0][:order]]
    radius = float(np.max(np.abs(np.roots(poly))))
    if radius > 1.0 and y.size / 4 * np.log(radius) > np.log(10.0):
        rate = np.log(radius) / (stride * data.dt)
        raise InputError(
            data.source,
            f"output {data.y_name} grows without limit (unstable, about e^({rate:.3g} t) in the end)",
            "data of a stable or stabilised system",
            f"cut the record before sample {int(edges[int(np.argmax(out > 10 * usual))])}, or close a loop",
        )


def _check_length(data: IOData, n: int, s: Structure) -> None:
    need = max(10, 2 * (s.n_parameters + s.n_plant_state + s.n_noise_state) + s.reach)
    if n < need:
        every = data.every * max(1, len(data) // max(1, n))
        kept = f"{n} samples" + (f" (every {every}th of the recording)" if every > 1 else "")
        raise InputError(data.source, kept, f"at least {need} for {s}", "record longer, decimate less or lower the orders")


def _check_excitation(data: IOData, u: np.ndarray, s: Structure) -> None:
    order = min(s.nb + s.na + s.nf, u.size // 3)
    rank = excited_directions(u, order)
    if rank < order:
        bands = missing_bands(u, data.dt * (len(data) / u.size))
        where = ", ".join(f"{low:.3g}-{high:.3g} Hz" for low, high in bands[:6]) or "between its few lines"
        raise InputError(
            data.source,
            f"input {data.u_name} excites only {rank} of the {order} directions that {s} needs; no power at {where}",
            "an input with power at more frequencies",
            "use a chirp or a multisine, or lower the orders",
        )


def check_estimation_data(data: IOData, s: Structure, *, clipping: bool = True) -> None:
    """Raise InputError for data that are too short, constant, rank-poor, diverging, or (``clipping``) clipped in their output."""
    _check_length(data, len(data), s)
    check_moving(data)
    if clipping:
        check_clipping(data, channels="y")
    check_diverging(data)
    _check_excitation(data, np.asarray(data.u), s)
