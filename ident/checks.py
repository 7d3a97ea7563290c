"""What data must have before a model is fitted to them; each lack is one clear line."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ident.data import IOData
from ident.structure import Structure
from mjsim.errors import InputError

__all__ = ["check_clipping", "check_estimation_data", "excited_bins", "missing_bands"]


def excited_bins(u: NDArray, floor: float = 1e-10) -> tuple[NDArray, NDArray]:
    """Frequencies [cycles per sample] and whether the input's power there exceeds ``floor`` of its largest line."""
    n = u.size
    window = np.hanning(n) if n > 2 else np.ones(n)
    power = np.abs(np.fft.rfft(u * window)) ** 2
    return np.arange(power.size) / n, power > floor * max(float(power.max()), 1e-300)


def missing_bands(u: NDArray, dt: float, floor: float = 1e-6) -> list[tuple[float, float]]:
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


def _rank(u: NDArray, order: int) -> int:
    """Order of persistent excitation up to ``order``: numerical rank of the covariance of ``order`` lags of u."""
    n = u.size
    columns = np.stack([u[order - i : n - i] for i in range(order)])
    values = np.linalg.eigvalsh(columns @ columns.T)
    return int(np.sum(values > 1e-14 * max(float(values[-1]), 1e-300)))


def check_clipping(data: IOData) -> None:
    """Raise when a channel sits at its own largest or smallest value for runs of samples, as a clipped one does."""
    for x, what in ((data.y, f"output {data.y_name}"),):
        span = float(np.ptp(x))
        if span == 0.0 or np.unique(x[:4096]).size < 12:
            continue  # constant is told elsewhere; a few levels only is a switching signal, not a clipped one
        for limit in (float(x.max()), float(x.min())):
            at = np.abs(x - limit) <= 1e-12 * span
            runs = np.flatnonzero(at[:-1] & at[1:] & np.r_[at[2:], False])
            share = float(np.mean(at))
            entries = np.flatnonzero(~at[:-1] & at[1:])
            if runs.size <= 3 or share <= 0.005 or limit == 0.0 or entries.size == 0:
                continue
            # a quantised signal dwells on its top step too, but gets there by one step; a clipped one arrives at speed
            step = float(np.min(np.diff(np.unique(x))))
            if float(np.median(np.abs(x[entries + 1] - x[entries]))) > 1.5 * step:
                raise InputError(
                    data.source,
                    f"{what} sits at its limit {limit:.6g} in {100 * share:.1f} % of the samples, "
                    f"first at sample {runs[0]} (clipped)",
                    "a signal within its range",
                    "record with less amplitude or a wider range",
                )


def check_estimation_data(data: IOData, s: Structure) -> None:
    """Raise InputError for data that are too short, constant, rank-poor, clipped or diverging."""
    n, need = len(data), 2 * (s.n_parameters + s.n_plant_state + s.n_noise_state) + s.reach
    if n < max(need, 10):
        raise InputError(
            data.source, f"{n} samples", f"at least {max(need, 10)} for {s}", "record longer, decimate less or lower the orders"
        )
    for x, what in ((data.u, f"input {data.u_name}"), (data.y, f"output {data.y_name}")):
        if float(np.ptp(x)) <= 1e-14 * max(float(np.max(np.abs(x))), 1e-300):
            raise InputError(data.source, f"{what} is constant ({x[0]:.6g})", "a signal that moves", "excite the system")
    check_clipping(data)
    quarter = max(1, n // 8)
    sizes = [float(np.std(data.y[i * quarter : (i + 1) * quarter])) for i in range(8)]
    inputs = [float(np.std(data.u[i * quarter : (i + 1) * quarter])) for i in range(8)]
    grows = all(b > 4.0 * a for a, b in pairwise(sizes))
    if grows and sizes[-1] > 1e4 * sizes[0] and max(inputs) < 1e3 * max(min(inputs), 1e-300):
        raise InputError(
            data.source, f"output {data.y_name} grows without limit (unstable)", "a stable or stabilised system", "close a loop"
        )
    order = min(s.nb + s.na + s.nf, n // 3)
    rank = _rank(np.asarray(data.u), order)
    if rank < order:
        bands = missing_bands(np.asarray(data.u), data.dt)
        where = ", ".join(f"{low:.3g}-{high:.3g} Hz" for low, high in bands[:6]) or "between its few lines"
        raise InputError(
            data.source,
            f"input {data.u_name} excites only {rank} of the {order} directions that {s} needs; no power at {where}",
            "an input with power at more frequencies",
            "use a chirp or a multisine, or lower the orders",
        )
